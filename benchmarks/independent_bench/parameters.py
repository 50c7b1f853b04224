"""Parameters of the plant: machine, battery, trial, and one group for every deviation, which a zero switches off.

In SI units. Named tuples, because the compiled equations of `plant` read them.
"""

from __future__ import annotations

from typing import NamedTuple


class Machine(NamedTuple):
    """Motor, gear and Scotch yoke; defaults of the paper's Table 3."""

    resistance_ohm: float = 0.176
    inductance_h: float = 3.21e-3
    back_emf_constant_v_s_per_rad: float = 7.383e-3
    torque_constant_n_m_per_a: float = 5.632e-3
    rotor_inertia_kg_m2: float = 2.4e-5
    yoke_inertia_kg_m2: float = 2.38e-5
    reciprocating_mass_kg: float = 0.239
    crank_radius_m: float = 0.01
    motor_damping_n_m_s_per_rad: float = 3.4274e-6
    gear_ratio: float = 56 / 6


class Battery(NamedTuple):
    """Battery of Eq. 16 of the paper."""

    nominal_voltage_v: float = 18.0
    charge_c: float = 5400.0
    beta: float = 0.99
    internal_resistance_ohm: float = 0.02


class Run(NamedTuple):
    """What the operator sets in a trial."""

    duty: float = 0.4375
    on_s: float = 0.1
    ramp_s: float = 0.003
    cutting_sign: float = -1.0  # -1: the blade cuts from pi to 2 pi
    cutting_coefficient_n_s_per_m: float = 0.0  # 0: the blade runs in air
    feed_mm_s: float = 0.0


class GuideFriction(NamedTuple):
    """LuGre friction of the plunger: kinetic force, static over kinetic, Stribeck speed, difference of directions."""

    force_n: float = 0.0
    static_ratio: float = 1.4
    stribeck_m_s: float = 0.06
    asymmetry: float = 0.0


class MotorFriction(NamedTuple):
    """Dry friction at the motor, higher by `static_share` below `stribeck_rad_s`."""

    torque_n_m: float = 0.0
    static_share: float = 0.35
    stribeck_rad_s: float = 60.0


class Windage(NamedTuple):
    """Drag of the fan: torque at 1000 rad/s, exponent of the speed."""

    torque_n_m: float = 0.0
    exponent: float = 2.0


class LoadFriction(NamedTuple):
    """Friction of the mesh as a share of all the torque it passes on, of the pin as a share of the force on it."""

    mesh_share: float = 0.0
    pin_share: float = 0.0


class Play(NamedTuple):
    """Gap between pin and yoke, m, and the stiffness of their contact, N/m."""

    gap_m: float = 0.0
    stiffness_n_per_m: float = 1.5e6


class Eccentricity(NamedTuple):
    """Torque at the motor that swings once a turn of the crank, and its second harmonic as a share."""

    torque_n_m: float = 0.0
    phase_rad: float = 0.0
    second_share: float = 0.0
    second_phase_rad: float = 0.0


class Blade(NamedTuple):
    """Spring between plunger and teeth, in series with the linear cutting law; its stiffness grows with deflection."""

    compliance_m_per_n: float = 0.0
    hardening_per_m: float = 0.0


class Rubbing(NamedTuple):
    """Force on the way back: viscous with an exponent (N s/m at 0.8 m/s), and dry."""

    damping_n_s_per_m: float = 0.0
    exponent: float = 0.8
    dry_n: float = 0.0


class Teeth(NamedTuple):
    """Ripple of the cutting force over the position of the blade, with a second harmonic as a share."""

    depth: float = 0.0
    pitch_m: float = 0.003
    phase_rad: float = 0.0
    second_share: float = 0.25


class SpeedLaw(NamedTuple):
    """Force over cutting speed: a power, rounded at zero, or a logarithm; linear through the reference."""

    exponent: float = 1.0
    logarithm: float = 0.0
    reference_m_s: float = 0.8


class Edge(NamedTuple):
    """Force of the blunt edge, whatever the speed, reached over `speed_m_s`."""

    force_n: float = 0.0
    speed_m_s: float = 0.03


class Chip(NamedTuple):
    """Coefficient over the thickness of the chip (feed per stroke, mm): (h + h0) to a power, 1 at the reference."""

    exponent: float = 0.0
    reference_mm: float = 1.0
    floor_mm: float = 0.0


class Wear(NamedTuple):
    """Growth of the coefficient per 10 m of cut; a share of it is a break-in that saturates."""

    growth_per_10_m: float = 0.0
    break_in_share: float = 0.0
    break_in_m: float = 20.0


class Engagement(NamedTuple):
    """Share of the cutting half without force, and the length over which the teeth take hold, m."""

    fraction: float = 0.0
    width_m: float = 4e-4


class Heating(NamedTuple):
    """Winding over its loss, K/W: a node that warms up in tens of seconds and one in minutes."""

    fast_k_per_w: float = 0.0
    fast_s: float = 30.0
    slow_k_per_w: float = 0.0
    slow_s: float = 300.0


class Magnets(NamedTuple):
    """Magnets over the loss of the winding, K/W, one node; share of the flux lost per kelvin."""

    heating_k_per_w: float = 0.0
    time_s: float = 90.0
    loss_per_k: float = 0.0015


class Brushes(NamedTuple):
    """Voltage of the brushes, its current scale, and how it grows with the logarithm of the current."""

    voltage_v: float = 0.0
    scale_a: float = 0.8
    growth: float = 0.0


class Diode(NamedTuple):
    """Forward voltage of the freewheeling diode: at 10 A times a polynomial of i / 10 A that is 1 there."""

    voltage_v: float = 0.0
    constant: float = 0.75
    linear: float = 0.3
    square: float = -0.05


class Converter(NamedTuple):
    """Loss of the converter: share of the current, of current times voltage, conduction, and a quiescent current."""

    loss_share: float = 0.0
    linear: float = 1.0
    square: float = 0.0
    quiescent_a: float = 0.0


class Limiter(NamedTuple):
    """Duty that is pulled back above a current, per ampere, with a lag."""

    current_a: float = 0.0
    gain_per_a: float = 0.06
    lag_s: float = 0.004


class ExtraResistance(NamedTuple):
    """Resistance of the battery beyond the stated one, full, and its growth as the battery empties."""

    resistance_ohm: float = 0.0
    growth: float = 0.0


class Polarization(NamedTuple):
    """Two relaxations (RC) of the battery."""

    fast_ohm: float = 0.0
    fast_s: float = 4.0
    slow_ohm: float = 0.0
    slow_s: float = 30.0


class Slip(NamedTuple):
    """Belt between motor and crank: slip at the usual peak torque, faster than in proportion above it."""

    share: float = 0.0
    torque_n_m: float = 0.15


class Bumper(NamedTuple):
    """Spring at the outer dead centre (Hertz: N over m to 1.5), hit over the last `length_m`, with a loss."""

    stiffness_n_per_m15: float = 0.0
    length_m: float = 2.5e-3
    loss_share: float = 0.4


class Mount(NamedTuple):
    """Body of the motor on rubber: turned by the motor's torque and a part of the gear's reaction."""

    inertia_kg_m2: float = 0.0
    stiffness_n_m_per_rad: float = 0.0
    damping_n_m_s_per_rad: float = 0.0


class Armature(NamedTuple):
    """Flux lost at a current, growing with its square, then levelling off."""

    share: float = 0.0
    current_a: float = 10.0


class Packing(NamedTuple):
    """Chips that fill the gullets: growth of the coefficient within each cut, and its time."""

    growth: float = 0.0
    time_s: float = 2.5


class Plant(NamedTuple):
    """All parameters: the bench, the trial, and one group for every deviation."""

    machine: Machine = Machine()
    battery: Battery = Battery()
    run: Run = Run()
    guide: GuideFriction = GuideFriction()
    friction: MotorFriction = MotorFriction()
    windage: Windage = Windage()
    load_friction: LoadFriction = LoadFriction()
    play: Play = Play()
    eccentricity: Eccentricity = Eccentricity()
    blade: Blade = Blade()
    rubbing: Rubbing = Rubbing()
    teeth: Teeth = Teeth()
    law: SpeedLaw = SpeedLaw()
    edge: Edge = Edge()
    chip: Chip = Chip()
    wear: Wear = Wear()
    engagement: Engagement = Engagement()
    heating: Heating = Heating()
    magnets: Magnets = Magnets()
    brushes: Brushes = Brushes()
    diode: Diode = Diode()
    converter: Converter = Converter()
    limiter: Limiter = Limiter()
    extra_resistance: ExtraResistance = ExtraResistance()
    polarization: Polarization = Polarization()
    slip: Slip = Slip()
    bumper: Bumper = Bumper()
    mount: Mount = Mount()
    armature: Armature = Armature()
    packing: Packing = Packing()
