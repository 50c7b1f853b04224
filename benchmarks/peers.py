"""The same equations in other people's solvers, each set so that it just reaches the accuracy asked for.

scipy is always there; heyoka, numbalsoda, diffrax and casadi where they are installed (the extra `peers`).
"""

from __future__ import annotations

import importlib.util
import math

import numba
import numpy as np

from benchmarks.limit_kernels import GEAR, J0, J2, KE, KM, QAS, RC, B, L, R

V0 = 18.0
TOLERANCES = (1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 3e-8, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
_HAS = {name: importlib.util.find_spec(name) is not None for name in ("heyoka", "numbalsoda", "diffrax", "casadi")}


def rhs(t, y, u, kfc):
    """Current, motor speed, motor angle at a fixed voltage."""
    s, c = math.sin(y[2] / GEAR), math.cos(y[2] / GEAR)
    drag = B + (kfc * (RC / GEAR) ** 2 * s * s if s < 0.0 else 0.0)
    dw = (KM * y[0] - drag * y[1] - J2 / GEAR * s * c * y[1] * y[1]) / (J0 + J2 * s * s)
    return np.array([(u - R * y[0] - KE * y[1]) / L, dw, y[1]])


fast_rhs = numba.njit(cache=True)(rhs)


def battery_rhs(t, y, duty, kfc, beta, r_b, sign):
    """The same with the charge of an Eq. 16 battery behind a fixed duty; `sign` of the half that cuts."""
    s, c = math.sin(y[2] / GEAR), math.cos(y[2] / GEAR)
    drag = B + (kfc * (RC / GEAR) ** 2 * s * s if s * sign > 0.0 else 0.0)
    u = duty * (V0 * y[3] / (1.0 - beta * (1.0 - y[3])) - r_b * duty * y[0])
    dw = (KM * y[0] - drag * y[1] - J2 / GEAR * s * c * y[1] * y[1]) / (J0 + J2 * s * s)
    return np.array([(u - R * y[0] - KE * y[1]) / L, dw, y[1], -duty * y[0] / QAS])


fast_battery_rhs = numba.njit(cache=True)(battery_rhs)


def reference(u, kfc, times):
    """Motor current by DOP853 at 1e-13, split at the dead centres."""
    from scipy.integrate import solve_ivp

    out, y, t, half = np.empty(len(times)), np.zeros(3), 0.0, 0

    def event(_, y, half):
        return y[2] / GEAR - (half + 1) * math.pi

    event.terminal, event.direction = True, 1

    def one_half(t, y, half):
        s, c = math.sin(y[2] / GEAR), math.cos(y[2] / GEAR)
        drag = B + (kfc * (RC / GEAR) ** 2 * s * s if half % 2 else 0.0)
        dw = (KM * y[0] - drag * y[1] - J2 / GEAR * s * c * y[1] * y[1]) / (J0 + J2 * s * s)
        return [(u - R * y[0] - KE * y[1]) / L, dw, y[1]]

    while t < times[-1]:
        done = solve_ivp(
            one_half, (t, times[-1]), y, method="DOP853", rtol=1e-13, atol=1e-13, events=event, args=(half,),
            dense_output=True,
        )  # fmt: skip
        here = (times >= t) & (times <= done.t[-1])
        if here.any():
            out[here] = done.sol(times[here])[0]
        t, y, half = done.t[-1], done.y[:, -1], half + 1
    return out


def one_second(u, kfc, times):
    """Pairs (name, solve) with solve(tolerance) -> motor current at the times."""
    from scipy.integrate import odeint, solve_ivp

    zero = np.zeros(3)
    args = (u, kfc)
    yield (
        "scipy odeint, numba rhs",
        lambda tol: odeint(fast_rhs, zero, times, args=args, tfirst=True, rtol=tol, atol=tol)[:, 0],
    )
    yield (
        "scipy odeint, Python rhs",
        lambda tol: odeint(rhs, zero, times, args=args, tfirst=True, rtol=tol, atol=tol)[:, 0],
    )
    for method in ("LSODA", "RK45", "Radau"):
        yield (
            f"scipy solve_ivp {method}",
            lambda tol, method=method: solve_ivp(
                fast_rhs, (0, times[-1]), zero, method=method, t_eval=times, args=args, rtol=max(tol, 3e-14), atol=tol
            ).y[0],
        )
    for name, make in (("heyoka", _heyoka), ("numbalsoda", _numbalsoda), ("diffrax", _diffrax), ("casadi", _casadi)):
        if _HAS[name]:
            yield from make(u, kfc, times)


def _heyoka_system(u, kfc):
    import heyoka as hy

    i, w, a = hy.make_vars("i", "w", "a")
    s, c = hy.sin(a / GEAR), hy.cos(a / GEAR)
    cuts = hy.par[0]
    dw = (KM * i - (B + cuts * kfc * (RC / GEAR) ** 2 * s * s) * w - J2 / GEAR * s * c * w * w) / (J0 + J2 * s * s)
    return hy, (i, w, a), s, [(i, (u - R * i - KE * w) / L), (w, dw), (a, w)]


def _heyoka(u, kfc, times):
    hy, _, s, system = _heyoka_system(u, kfc)
    made = {}

    def passes(ta, d_sign):
        ta.pars[0] = 1.0 - ta.pars[0]
        return True

    def solve(tol):
        if tol not in made:
            events = [hy.t_event(s, callback=passes)]
            made[tol] = hy.taylor_adaptive(system, [0.0, 0.0, 1e-12], pars=[0.0], t_events=events, tol=tol)
        ta = made[tol]
        ta.time, ta.state[:], ta.pars[:] = 0.0, (0.0, 0.0, 1e-12), 0.0
        ta.reset_cooldowns()
        return ta.propagate_grid(times)[-1][:, 0]

    yield "heyoka (Taylor, events)", solve


def _numbalsoda(u, kfc, times):
    from numbalsoda import dop853, lsoda, lsoda_sig

    @numba.cfunc(lsoda_sig)
    def compiled(t, y, dy, p):
        s, c = math.sin(y[2] / GEAR), math.cos(y[2] / GEAR)
        drag = B + (p[1] * (RC / GEAR) ** 2 * s * s if s < 0.0 else 0.0)
        dy[0] = (p[0] - R * y[0] - KE * y[1]) / L
        dy[1] = (KM * y[0] - drag * y[1] - J2 / GEAR * s * c * y[1] * y[1]) / (J0 + J2 * s * s)
        dy[2] = y[1]

    data = np.array([u, kfc])
    for name, method in (("lsoda", lsoda), ("dop853", dop853)):
        yield (
            f"numbalsoda {name}",
            lambda tol, method=method: method(compiled.address, np.zeros(3), times, data, rtol=tol, atol=tol)[0][:, 0],
        )


def _diffrax(u, kfc, times):
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)

    def field(t, y, args):
        s, c = jnp.sin(y[2] / GEAR), jnp.cos(y[2] / GEAR)
        drag = B + jnp.where(s < 0.0, args[1] * (RC / GEAR) ** 2 * s * s, 0.0)
        dw = (KM * y[0] - drag * y[1] - J2 / GEAR * s * c * y[1] * y[1]) / (J0 + J2 * s * s)
        return jnp.array([(args[0] - R * y[0] - KE * y[1]) / L, dw, y[1]])

    grid = jnp.asarray(times)
    made = {}

    def solve(tol):
        if tol not in made:

            @jax.jit
            def compiled(args):
                return diffrax.diffeqsolve(
                    diffrax.ODETerm(field), diffrax.Tsit5(), 0.0, times[-1], None, jnp.zeros(3), args,
                    saveat=diffrax.SaveAt(ts=grid), max_steps=100_000,
                    stepsize_controller=diffrax.PIDController(rtol=tol, atol=tol),
                ).ys[:, 0]  # fmt: skip

            made[tol] = compiled
        return np.asarray(made[tol](jnp.array([u, kfc])).block_until_ready())

    yield "diffrax Tsit5, jitted", solve


def _casadi(u, kfc, times):
    import casadi as ca

    y = ca.MX.sym("y", 3)
    s, c = ca.sin(y[2] / GEAR), ca.cos(y[2] / GEAR)
    drag = B + ca.if_else(s < 0, kfc * (RC / GEAR) ** 2 * s * s, 0.0)
    dw = (KM * y[0] - drag * y[1] - J2 / GEAR * s * c * y[1] ** 2) / (J0 + J2 * s * s)
    ode = {"x": y, "ode": ca.vertcat((u - R * y[0] - KE * y[1]) / L, dw, y[1])}
    made = {}

    def solve(tol):
        if tol not in made:
            options = {"reltol": tol, "abstol": tol, "max_num_steps": 100_000}
            made[tol] = ca.integrator("f", "cvodes", ode, 0.0, list(times[1:]), options)
        return np.concatenate([[0.0], np.asarray(made[tol](x0=[0, 0, 0])["xf"])[0]])

    yield "casadi cvodes", solve


def whole_discharge(duty, kfc, beta, r_b, sign, near_s):
    """Pairs (name, solve) with solve(tolerance) -> runtime to 20 %, s; `near_s` brackets it."""
    from scipy.integrate import odeint

    start = np.array([0.0, 0.0, 0.0, 1.0])
    args = (duty, kfc, beta, r_b, sign)
    times = np.concatenate([[0.0], near_s + np.linspace(-0.02, 0.02, 41)])

    def crossing(soc):
        return float(np.interp(-0.2, -soc[1:], times[1:]))

    if _HAS["heyoka"]:
        yield from _heyoka_discharge(duty, kfc, beta, r_b, sign, near_s)
    yield (
        "scipy odeint, numba rhs",
        lambda tol: crossing(
            odeint(
                fast_battery_rhs, start, times, args=args, tfirst=True, rtol=tol, atol=tol * 1e-3, mxstep=10_000_000
            )[:, 3]
        ),
    )


def _heyoka_discharge(duty, kfc, beta, r_b, sign, near_s):
    import heyoka as hy

    i, w, a, q = hy.make_vars("i", "w", "a", "q")
    s, c = hy.sin(a / GEAR), hy.cos(a / GEAR)
    drag = B + hy.par[0] * kfc * (RC / GEAR) ** 2 * s * s
    u = duty * (V0 * q / (1.0 - beta * (1.0 - q)) - r_b * duty * i)
    dw = (KM * i - drag * w - J2 / GEAR * s * c * w * w) / (J0 + J2 * s * s)
    system = [(i, (u - R * i - KE * w) / L), (w, dw), (a, w), (q, -duty * i / QAS)]
    made = {}
    first = 1.0 if sign > 0 else 0.0

    def passes(ta, d_sign):
        ta.pars[0] = 1.0 - ta.pars[0]
        return True

    def solve(tol):
        if tol not in made:
            events = [hy.t_event(s, callback=passes), hy.t_event(q - 0.2)]
            made[tol] = hy.taylor_adaptive(system, [0.0, 0.0, 1e-12, 1.0], pars=[first], t_events=events, tol=tol)
        ta = made[tol]
        ta.time, ta.state[:], ta.pars[:] = 0.0, (0.0, 0.0, 1e-12, 1.0), first
        ta.reset_cooldowns()
        ta.propagate_until(near_s + 10.0)
        return float(ta.time)

    yield "heyoka (Taylor, events)", solve
