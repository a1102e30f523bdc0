"""Friction and accelerations at one state, compiled by Numba.

Numba is optional; `sklearn_vbjfa.simulation._dynamics` does the same in NumPy. The laws
of friction are those of `sklearn_vbjfa.simulation._terms` themselves.
"""

import numba
import numpy as np

from sklearn_vbjfa.simulation import _steps, _terms
from sklearn_vbjfa.simulation._compiled_bodies import bodies_at

# The machine code is kept on disk: only the first use after an installation takes the
# seconds of the compilation.
_compiled = numba.njit(nogil=True, cache=True, error_model="numpy")
_add_terms = _compiled(_terms.add_terms)
remember = _compiled(_terms.remember)
step_error = _compiled(_steps.step_error)
is_stiff = _compiled(_steps.is_stiff)
load_size = _compiled(_steps.load_size)
directions = _compiled(_steps.directions)
past_events = _compiled(_steps.past_events)
# Times that it is found anew how friction follows the loads.
_MOST_SIGNS = 8


@_compiled
def _eliminate(A, b):
    """Solve A x = b in place by elimination with row exchanges; x is in b."""
    n = b.size
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        if best != k:
            for c in range(n):
                A[k, c], A[best, c] = A[best, c], A[k, c]
            b[k], b[best] = b[best], b[k]
        inverse = 1.0 / A[k, k]
        for i in range(k + 1, n):
            factor = A[i, k] * inverse
            if factor != 0.0:
                for c in range(k + 1, n):
                    A[i, c] -= factor * A[k, c]
                b[i] -= factor * b[k]
    for k in range(n - 1, -1, -1):
        for c in range(k + 1, n):
            b[k] -= A[k, c] * b[c]
        b[k] /= A[k, k]


@_compiled
def _hold(A, b, stuck):
    """Replace the equations of joints that stick by that of no acceleration."""
    n = b.size
    for j in range(n):
        if stuck[j]:
            # Its column as well: rounding would set the joint in motion.
            for c in range(n):
                A[j, c] = A[c, j] = 0.0
            A[j, j] = 1.0
            b[j] = 0.0


@_compiled
def accelerate(
    M,
    h,
    ML,
    hL,
    tau,
    q,
    v,
    mode,
    stuck,
    of_load,
    lines,
    inertia,
    coupling,
    kinds,
    joints,
    numbers,
    memory,
    before,
    out,
):
    """Accelerations at one state, see `ForwardDynamics.accelerate`; power [W]."""
    # M, h, ML, hL: inertia matrix and nonlinear effects of the robot, and of what loads
    # joints; tau, q, v, mode, stuck (nv,): true torques, state, signs of dry friction,
    # joints that stick.
    # lines (6, nv): viscous friction, constant torque, dry friction, that over the
    # load, and the ends of the load that it follows; of_load: whether friction depends
    # on it; inertia, coupling (nv, nv): torque by acceleration and velocity, see
    # `Terms`.
    # kinds, joints, numbers, memory: table of terms; before (nv,): accelerations found
    # before; out (5, nv), written: accelerations, needed dry friction, its limit,
    # derivatives by position and velocity. The power is that of torques that do not
    # dissipate.
    nv = q.size
    placed, smooth = lines[1].copy(), lines[0] * v
    dry, load_smooth = lines[2].copy(), np.zeros(nv)
    by_position, by_velocity = np.zeros(nv), lines[0].copy()
    load_by_velocity = np.zeros(nv)
    for i in range(nv):
        for j in range(nv):
            placed[i] += coupling[i, j] * v[j]
        by_velocity[i] += coupling[i, i]
    _add_terms(
        kinds,
        joints,
        numbers,
        memory,
        q,
        v,
        placed,
        smooth,
        dry,
        load_smooth,
        by_position,
        by_velocity,
        load_by_velocity,
    )
    A, rhs = np.empty((nv, nv)), np.empty(nv)
    for i in range(nv):
        rhs[i] = tau[i] - h[i] - placed[i] - smooth[i] - dry[i] * mode[i]
        for j in range(nv):
            A[i, j] = M[i, j] + inertia[i, j]
    a = rhs.copy()
    limit = dry
    if of_load:
        L, size = hL.copy(), np.empty(nv)
        for i in range(nv):
            for j in range(nv):
                L[i] += ML[i, j] * before[j]
            size[i] = lines[3, i] * mode[i] + load_smooth[i]
        constant, slope = load_size(L, lines[4], lines[5])
        pressed = constant + slope * L
        for _ in range(_MOST_SIGNS):
            B = A.copy()
            for i in range(nv):
                way = size[i] * slope[i]
                for j in range(nv):
                    B[i, j] += way * ML[i, j]
                a[i] = rhs[i] - way * hL[i] - size[i] * constant[i]
            _hold(B, a, stuck)
            _eliminate(B, a)
            for i in range(nv):
                L[i] = hL[i]
                for j in range(nv):
                    L[i] += ML[i, j] * a[j]
            supposed = constant + slope * L
            constant, slope = load_size(L, lines[4], lines[5])
            pressed = constant + slope * L
            if (pressed == supposed).all():
                break
        for i in range(nv):
            rhs[i] -= size[i] * pressed[i]
            limit[i] += lines[3, i] * pressed[i]
            by_velocity[i] += load_by_velocity[i] * pressed[i]
    else:
        B = A.copy()
        _hold(B, a, stuck)
        _eliminate(B, a)
    for i in range(nv):
        if stuck[i]:
            # What rounding leaves would be a motion.
            a[i] = 0.0
    power = 0.0
    for i in range(nv):
        needed, moved = rhs[i], tau[i] - placed[i]
        for j in range(nv):
            needed -= A[i, j] * a[j]
            moved -= inertia[i, j] * a[j]
        out[0, i], out[1, i], out[2, i] = a[i], needed, limit[i]
        out[3, i], out[4, i] = by_position[i], by_velocity[i]
        power += moved * v[i]
    return power


@_compiled
def explicit_step(
    q,
    v,
    a,
    power,
    tau,
    rate,
    h,
    mode,
    stuck,
    fast,
    tolerance,
    tree,
    bodies,
    armature,
    loaded,
    of_load,
    lines,
    inertia,
    coupling,
    kinds,
    joints,
    numbers,
    memory,
):
    """Runge-Kutta step of order four, its error by one of order three."""
    # q, v, a, power: at the beginning; tau, rate (nv,): torques there, and what they
    # change by in a second; h: length of the step [s]; fast (nv,): fastest speeds, in
    # units of which `tolerance` is; loaded (nv, 10): bodies that load the joints; the
    # rest as `bodies_at` and `accelerate`.
    # Returns q, v at the end, the work of torques that do not dissipate [J], power,
    # error in units of what is allowed, what `accelerate` writes (5, nv), and M there.
    nv = q.size
    M, ML, before = np.empty((nv, nv)), np.empty((nv, nv)), a
    effects, load = np.empty(nv), np.empty(nv)
    none = np.zeros(nv)
    found = np.empty((5, 5, nv))
    speeds, powers = np.empty((5, nv)), np.empty(5)
    speeds[0], powers[0] = v, power
    found[0, 0] = a
    new_q, new_v = q, v
    for k in range(1, 5):
        # Stages in the middle, in the middle, at the end; and the end itself.
        step = 0.5 * h if k < 3 else h
        if k < 4:
            new_q = q + step * speeds[k - 1]
            new_v = v + step * found[k - 1, 0]
        else:
            sixth = h / 6.0
            new_q = q + sixth * (speeds[0] + 2.0 * (speeds[1] + speeds[2]) + speeds[3])
            new_v = v + sixth * (
                found[0, 0] + 2.0 * (found[1, 0] + found[2, 0]) + found[3, 0]
            )
        bodies_at(new_q, new_v, tree, bodies, armature, M, effects)
        if of_load:
            bodies_at(new_q, new_v, tree, loaded, none, ML, load)
        powers[k] = accelerate(
            M,
            effects,
            ML,
            load,
            tau + step * rate,
            new_q,
            new_v,
            mode,
            stuck,
            of_load,
            lines,
            inertia,
            coupling,
            kinds,
            joints,
            numbers,
            memory,
            before,
            found[k],
        )
        before, speeds[k] = found[k, 0], new_v
    work = (powers[0] + 2.0 * (powers[1] + powers[2]) + powers[3]) * h / 6.0
    error = step_error(h, a, found[3, 0], found[4, 0], fast, tolerance)
    return new_q, new_v, work, powers[4], error, found[4].copy(), M
