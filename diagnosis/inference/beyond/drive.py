"""Laws of motor, converter, transmission and plunger that model and catalogue take as ideal."""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.current_limit import held_back
from sawbench.modeling.effects.effect import Effect, Strength
from sawbench.modeling.effects.heat import SPIN_HEAT
from sawbench.modeling.effects.magnet_weakening import weaker_flux
from sawbench.modeling.residuals import Baseline, Signature, inertia_torque, is_angle_known, motor_ahead
from sawbench.modeling.state import START_UP_STEP_S, State, angle_derivative

# The torque of viscous friction is stated at this speed of the motor.
_UNIT_RAD_S = 1000.0
# From here to the end of the stroke the springs reach, in radii from its middle.
_SPRINGS_BEGIN = (0.0, 0.3, 0.6, 0.75, 0.88)
# Hertz: the force of a rounded end grows with this power of the way.
_CONTACT_POWER = 1.5


def _carried_torque(baseline: Baseline, state: State) -> Floats:
    """Torque that the shaft hands on from the motor, N*m at the motor, shape of the state."""
    plant = baseline.plant
    wheel = inertia_torque(baseline, state, yoke=plant.yoke_inertia_kg_m2.nominal)
    plunger = inertia_torque(baseline, state, mass=plant.reciprocating_mass_kg.nominal)
    cut = 0.0 if state.force_n is None else baseline.load_torque(state, state.force_n)
    return wheel + plunger + cut


def _yielding_transmission(baseline: Baseline, state: State, slips: float) -> tuple[Signature, ...]:
    """A shaft that twists by the torque over that of the usual cut, or a belt that slips with it and its square."""
    nothing = tuple(Signature() for _ in range(_n_yielding({"slips": slips})))
    if state.kind != "running" or state.current_a is None or not is_angle_known(state):
        return nothing
    share = _carried_torque(baseline, state) / baseline.load.torque_n_m
    turned = (share, share * np.abs(share)) if slips else (angle_derivative(share),)
    speeds = (baseline.gear * state.speed_rad_s * part for part in turned)
    return tuple(motor_ahead(baseline, speed, state.speed_rad_s * angle_derivative(speed)) for speed in speeds)


def _n_yielding(shape: dict[str, float]) -> int:
    return 2 if shape["slips"] else 1


def _falling_flux(baseline: Baseline, state: State, power: float) -> tuple[Signature, ...]:
    """Back-EMF and torque of a current that weakens the field, by a power of it over that of the usual cut."""
    if state.current_a is None:
        return ({},)
    loss = np.abs(state.current_a / baseline.usual_current_a) ** power
    return (weaker_flux(baseline, state, state.current_a, loss),)


def _sprung_plunger(baseline: Baseline, state: State, begins: float, rubs: float) -> tuple[Signature, ...]:
    """A spring or a tight place at either end of the stroke, each with its own force."""
    if state.current_a is None or not is_angle_known(state):
        return ({}, {})
    at = baseline.mechanism.displacement(state.angle_rad) / baseline.radius_m - 1.0
    lever = baseline.lever(state)
    power = _CONTACT_POWER if begins and not rubs else 1.0
    found: list[Signature] = []
    for end in (1.0, -1.0):
        pressed = (np.maximum(end * at - begins, 0.0) / (1.0 - begins)) ** power
        # A spring pushes back to the middle and gives the work back; what rubs is against the motion on both ways.
        found.append({"mechanical": pressed * (np.abs(lever) if rubs else end * lever) / baseline.gear})
    return tuple(found)


def _regulated_duty(_: Baseline, state: State, of_mean: float, sign: float) -> tuple[Signature, ...]:
    """A voltage that the electronics raise or lower with the load: in proportion to the current over the largest."""
    if state.kind != "running" or state.current_a is None or state.top_current_a <= 0.0:
        return ({},)
    load = state.current_a / state.top_current_a
    if of_mean:
        load = np.broadcast_to(load.mean(axis=-1, keepdims=True), load.shape)
    return (held_back(state, state.current_a, -sign * load * state.motor_voltage_v),)


def _warming_friction(
    baseline: Baseline, state: State, time_constant_s: float, viscous: float
) -> tuple[Signature, ...]:
    """Friction that falls while the machine runs and is back after a rest: stiff grease, cold bearings.

    Dry friction that does not fall is its limit, and in the catalogue. Viscous friction that hardly falls while a trial
    lasts is a wrong number of the model: it counts where it falls to 1/e.
    """
    if viscous and float(np.max(state.time_s)) < time_constant_s:
        return ({},)
    cold = np.exp(-np.broadcast_to(state.time_s, state.angle_rad.shape) / time_constant_s)
    speed = baseline.gear * state.speed_rad_s
    return ({"mechanical": cold * (speed / _UNIT_RAD_S if viscous else np.ones_like(speed))},)


def _softening_friction(
    baseline: Baseline, state: State, time_constant_s: float, softens: float
) -> tuple[Signature, ...]:
    """Friction that falls with what the machine has run, over the whole session, and comes back as slowly.

    `softens` is the logarithm by which it falls where the motor runs on and on at the speed of the usual cut.
    """
    warm = baseline.gear**2 * state.slow[SPIN_HEAT[time_constant_s]] / baseline.load.motor_speed_rad_s**2
    return ({"mechanical": np.broadcast_to(np.exp(-softens * warm), state.angle_rad.shape)},)


def _soft_start(
    baseline: Baseline, state: State, length_s: float, from_share: float, decays: float
) -> tuple[Signature, ...]:
    """Voltage held back at the start, at any current: a ramp of the duty, or one that ends like a decay.

    As with a current limit, the baseline still counts it (electrical residual positive) and expects more battery
    current (converter residual negative, by the same share of the current).
    """
    if state.kind != "start_up" or state.current_a is None:
        return ({},)
    since_s = (np.arange(state.angle_rad.shape[1]) + 0.5) * START_UP_STEP_S
    missing = np.exp(-since_s / length_s) if decays else np.maximum(1.0 - since_s / length_s, 0.0)
    return (held_back(state, state.current_a, (1.0 - from_share) * missing * state.motor_voltage_v),)


_COLD_TORQUE = Strength(name="torque_n_m", unit="N*m", typical=0.005, low=0.2, high=4.0, source="assumed")
WARMING_FRICTION = Effect(
    name="friction that falls as the machine warms up",
    place="mechanical",
    equation="tau * exp(-t / T) on the motor shaft, again after each rest",
    strength=_COLD_TORQUE,
    signature=_warming_friction,
    shapes=tuple(
        {"time_constant_s": float(tau), "viscous": viscous} for tau in (3.0, 10.0, 30.0) for viscous in (0.0, 1.0)
    ),
    confused_with=("motor_coulomb_friction",),
)
SOFTENING_FRICTION = Effect(
    name="friction that falls with what the machine has run in the session",
    place="mechanical",
    equation="tau * exp(-s q) on the motor shaft, T q' = w^2 / w_usual^2 - q",
    strength=_COLD_TORQUE,
    signature=_softening_friction,
    shapes=tuple(
        {"time_constant_s": tau, "softens": softens}
        for tau in (15.0, 40.0, 100.0, 300.0)
        for softens in (0.7, 2.0, 5.0)
    ),
    confused_with=("motor_coulomb_friction",),
)
SOFT_START = Effect(
    name="voltage ramp at every start",
    place="electrical",
    equation="duty * (1 - (1 - d_0) g(t / T)) after the start, g a ramp or a decay",
    strength=Strength(
        name="voltage_share_held_back", unit="1", typical=1.0, low=0.5, high=1.2, source="assumed; power-tool switches"
    ),
    signature=_soft_start,
    shapes=(
        *(
            {"length_s": float(length), "from_share": share, "decays": 0.0}
            for length in np.geomspace(0.02, 0.8, 12)
            for share in (0.0, 0.25, 0.5)
        ),
        *({"length_s": float(length), "from_share": 0.0, "decays": 1.0} for length in np.geomspace(0.01, 0.4, 10)),
    ),
    confused_with=("current_limit",),
)
YIELDING_TRANSMISSION = Effect(
    name="transmission that yields under load",
    place="mechanical",
    equation="motor angle = gear * (crank angle + c T), or motor speed = gear * crank speed * (1 + s T + q T |T|)",
    strength=Strength(name="twist_rad_or_slip", unit="1", typical=0.02, low=0.05, high=10.0, source="assumed"),
    signature=_yielding_transmission,
    n_signatures=_n_yielding,
    shapes=({"slips": 0.0}, {"slips": 1.0}),
)
FALLING_FLUX = Effect(
    name="flux that falls with the current",
    place="electrical",
    equation="k_e, k_m * (1 - a (i / i_0)^n)",
    strength=Strength(
        name="flux_lost", unit="1", typical=0.05, low=0.05, high=10.0, source="assumed; armature reaction"
    ),
    signature=_falling_flux,
    shapes=({"power": 1.0}, {"power": 2.0}),
)
SPRUNG_PLUNGER = Effect(
    name="spring, stop or tight place on the way of the plunger",
    place="mechanical",
    equation="force of the plunger's position, at either end of the stroke",
    strength=Strength(
        name="force_n", unit="N", typical=20.0, low=0.05, high=10.0, source="assumed", follows=lambda load: load.force_n
    ),
    signature=_sprung_plunger,
    n_signatures=lambda shape: 2,
    # What rubs all the way is friction, and in the catalogue.
    shapes=tuple({"begins": b, "rubs": rubs} for b in _SPRINGS_BEGIN for rubs in (0.0, 1.0) if b or not rubs),
)
REGULATED_DUTY = Effect(
    name="duty that changes with the load",
    place="electrical",
    equation="duty * (1 +- a i / i_0), i at once or on average",
    strength=Strength(name="duty_share", unit="1", typical=0.1, low=0.05, high=10.0, source="assumed; speed control"),
    signature=_regulated_duty,
    shapes=tuple({"of_mean": mean, "sign": sign} for mean in (0.0, 1.0) for sign in (1.0, -1.0)),
)
