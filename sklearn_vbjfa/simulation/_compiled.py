"""Bodies, accelerations and explicit steps of a simulation, compiled by Numba.

The laws of friction are those of `sklearn_vbjfa.simulation._terms`; bodies are what
Pinocchio computes as well (`crba` and `nonLinearEffects`): vectors are in the axes of
the base, and moments about the origin of the joint that a branch begins with, so that
the inertia of composite bodies is a sum.
"""

import math

import numpy as np

from sklearn_vbjfa._core._compiler import compiler
from sklearn_vbjfa.model import _kernel
from sklearn_vbjfa.model._kernel import (
    ANGULAR,
    LINEAR,
    ORIGIN,
    advance,
    axpy,
    combine,
    cross,
    dot,
    get,
    put,
    wrench,
)
from sklearn_vbjfa.model._trees import Tree
from sklearn_vbjfa.simulation import _terms

# What is known of a body beside what `advance` writes: force and moment of all that it
# carries, and their mass, first moments and inertia.
_FORCE, _MOMENT, _MASS, _FIRST, _INERTIA = 27, 30, 33, 34, 37
_WHOLE = 46
_TINY = float(np.finfo(float).tiny)

compiled = compiler(__file__, _kernel.__file__, _terms.__file__)

_add_terms = compiled(_terms.add_terms)
remember = compiled(_terms.remember)
load_size = compiled(_terms.load_size)


@compiled
def step_error(h, a1, a4, a5, fast, tolerance):
    """Error of an explicit step in units of what is allowed; nan where it is none."""
    # a1, a4, a5 (nv,): accelerations at its beginning, its last slope, and at its end;
    # fast (nv,): fastest speeds.
    worst = 0.0
    for j in range(a1.size):
        own = abs(a4[j] - a5[j]) / (tolerance * max(fast[j], h * abs(a1[j])))
        worst = own if own > worst or own != own else worst
    return (h / 6.0) * worst


@compiled
def is_stiff(h, mass, by_position, by_velocity, stuck, most):
    """Whether friction or springs would keep an explicit step of length h short."""
    rate = stiffness = 0.0
    for j in range(stuck.size):
        if not stuck[j]:
            rate = max(rate, abs(by_velocity[j] / mass[j, j]))
            stiffness = max(stiffness, abs(by_position[j] / mass[j, j]))
    return h * max(rate, math.sqrt(stiffness)) > most


@compiled
def directions(v, a):
    """Ways that joints go (nv,): signs of velocities, or of accelerations at rest."""
    out = np.sign(v)
    for j in range(v.size):
        if v[j] == 0.0:
            out[j] = np.sign(a[j])
    return out


@compiled
def past_events(watched, way, v, exact, stuck, needed, limit, holds, loose):
    """How far joints are past an event, in units of what they may be, (nv,)."""
    # Those that slide turn round; exact (nv,): velocities that count as zero. Those
    # that stick break loose beyond `holds` times the limit of their friction. Negative
    # before the event, -inf for joints without any.
    out = np.full(v.size, -np.inf)
    for j in range(v.size):
        if stuck[j]:
            past = abs(needed[j]) - holds * limit[j]
            out[j] = past / max(loose * limit[j], _TINY)
        elif watched[j]:
            out[j] = -way[j] * v[j] / exact[j]
    return out


@compiled
def bodies_at(q, v, tree, bodies, armature, M, h):
    """Write the inertia matrix M (nv, nv) and nonlinear effects h (nv,) at a state."""
    # bodies (n, 10) of all joints, some of which may follow others; armature (nv,):
    # rotor inertias [kg m^2 or kg], which M includes; h: torques at rest of the
    # accelerations, gravity included.
    n, leads = tree.parents.size, tree.leads
    state = np.zeros((n, _WHOLE))
    for j in range(n):
        own, body = state[j], bodies[j]
        lead, rate = int(leads[j, 0]), leads[j, 1]
        position = rate * q[lead] + leads[j, 2]
        forces, moments = advance(state, tree, j, position, rate * v[lead], 0.0)
        force, moment = wrench(body, forces, moments)
        put(own, _FORCE, force)
        put(own, _MOMENT, moment)
        x, y, z, p = get(own, 0), get(own, 3), get(own, 6), get(own, ORIGIN)
        mass, first = body[0], combine((body[1], body[2], body[3]), x, y, z)
        # Its mass, first moments and inertia about the common origin.
        own[_MASS] = mass
        put(own, _FIRST, axpy(mass, p, first))
        tx = combine((body[4], body[5], body[7]), x, y, z)
        ty = combine((body[5], body[6], body[8]), x, y, z)
        tz = combine((body[7], body[8], body[9]), x, y, z)
        trace = mass * dot(p, p) + 2.0 * dot(p, first)
        for r in range(3):
            for c in range(3):
                value = x[r] * tx[c] + y[r] * ty[c] + z[r] * tz[c]
                value -= mass * p[r] * p[c] + p[r] * first[c] + first[r] * p[c]
                own[_INERTIA + 3 * r + c] = value
            own[_INERTIA + 4 * r] += trace
    M[:] = h[:] = 0.0
    for j in range(q.size):
        M[j, j] = armature[j]
    for j in range(n - 1, -1, -1):
        own, parent = state[j], tree.parents[j]
        lead, rate = int(leads[j, 0]), leads[j, 1]
        angular, linear = get(own, ANGULAR), get(own, LINEAR)
        first = get(own, _FIRST)
        torque = dot(angular, get(own, _MOMENT)) + dot(linear, get(own, _FORCE))
        h[lead] += rate * torque
        # Momentum of all that the joint carries, at its unit velocity.
        momentum = axpy(own[_MASS], linear, cross(angular, first))
        spin = (
            dot(get(own, _INERTIA), angular),
            dot(get(own, _INERTIA + 3), angular),
            dot(get(own, _INERTIA + 6), angular),
        )
        spin = axpy(1.0, spin, cross(first, linear))
        i = j
        while i >= 0:
            other = state[i]
            value = dot(get(other, ANGULAR), spin)
            value += dot(get(other, LINEAR), momentum)
            value *= leads[i, 1] * rate
            M[int(leads[i, 0]), lead] += value
            if i != j:
                M[lead, int(leads[i, 0])] += value
            i = tree.parents[i]
        if parent >= 0:
            for k in range(_FORCE, _WHOLE):
                state[parent, k] += own[k]


@compiled
def _eliminate(A, b):
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


@compiled
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


@compiled
def accelerate(M, h, ML, hL, tau, q, v, mode, stuck, table, before, out):
    """Write the accelerations at one state, see `ForwardDynamics.accelerate`."""
    # M, h, ML, hL: inertia matrix and nonlinear effects of the robot, and of what loads
    # joints; tau, q, v, mode, stuck (nv,): true torques, state, signs of dry friction,
    # joints that stick; before (nv,): accelerations found before; out (5, nv), written:
    # accelerations, needed dry friction, its limit, derivatives by position, velocity.
    nv = q.size
    lines, inertia, coupling = table.lines, table.inertia, table.coupling
    sums = np.zeros((7, nv))
    placed, smooth, dry, load_smooth = sums[0], sums[1], sums[2], sums[3]
    by_position, by_velocity, load_by_position = sums[4], sums[5], sums[6]
    for i in range(nv):
        placed[i], smooth[i] = lines[1, i], lines[0, i] * v[i]
        dry[i], by_velocity[i] = lines[2, i], lines[0, i] + coupling[i, i]
        for j in range(nv):
            placed[i] += coupling[i, j] * v[j]
    _add_terms(table.kinds, table.joints, table.numbers, table.memory, q, v, sums)
    A, rhs = np.empty((nv, nv)), np.empty(nv)
    for i in range(nv):
        rhs[i] = tau[i] - h[i] - placed[i] - smooth[i] - dry[i] * mode[i]
        for j in range(nv):
            A[i, j] = M[i, j] + inertia[i, j]
    a = rhs.copy()
    limit = dry
    if table.of_load:
        L, size = hL.copy(), np.empty(nv)
        for i in range(nv):
            for j in range(nv):
                L[i] += ML[i, j] * before[j]
            size[i] = lines[3, i] * mode[i] + load_smooth[i]
        constant, slope = load_size(L, lines[4], lines[5])
        pressed = constant + slope * L
        for _ in range(_terms.MOST_SIGNS):
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
            by_position[i] += load_by_position[i] * pressed[i]
    else:
        B = A.copy()
        _hold(B, a, stuck)
        _eliminate(B, a)
    for i in range(nv):
        if stuck[i]:
            # What rounding leaves would be a motion.
            a[i] = 0.0
    for i in range(nv):
        needed = rhs[i]
        for j in range(nv):
            needed -= A[i, j] * a[j]
        out[0, i], out[1, i], out[2, i] = a[i], needed, limit[i]
        out[3, i], out[4, i] = by_position[i], by_velocity[i]


@compiled
def explicit_step(q, v, a, tau, rate, h, mode, stuck, fast, tolerance, robot):
    # q, v, a: at the beginning; tau, rate (nv,): torques there and their change in a
    # second; h: length of the step [s]; fast (nv,): units of `tolerance`; robot: tree,
    # bodies, armature, loading bodies (nv, 10), table. Returns q, v at the end, error
    # in units of what is allowed, what `accelerate` writes (5, nv), and M there.
    nv, (tree, bodies, armature, loaded, table) = q.size, robot
    M, ML, before = np.empty((nv, nv)), np.empty((nv, nv)), a
    effects, load = np.empty(nv), np.empty(nv)
    none = np.zeros(nv)
    found, now = np.empty((5, 5, nv)), np.empty(nv)
    qs, vs = np.empty((5, nv)), np.empty((5, nv))
    for j in range(nv):
        vs[0, j], found[0, 0, j] = v[j], a[j]
    for k in range(1, 5):
        # Stages in the middle, in the middle, at the end; and the end itself.
        step = 0.5 * h if k < 3 else h
        for j in range(nv):
            speed, change = vs[k - 1, j], found[k - 1, 0, j]
            if k == 4:
                # Simpson's means
                speed = (vs[0, j] + 2.0 * (vs[1, j] + vs[2, j]) + speed) / 6.0
                change = 2.0 * (found[1, 0, j] + found[2, 0, j]) + change
                change = (found[0, 0, j] + change) / 6.0
            qs[k, j], vs[k, j] = q[j] + step * speed, v[j] + step * change
            now[j] = tau[j] + step * rate[j]
        new_q, new_v, out = qs[k], vs[k], found[k]
        bodies_at(new_q, new_v, tree, bodies, armature, M, effects)
        if table.of_load:
            bodies_at(new_q, new_v, tree, loaded, none, ML, load)
        accelerate(
            M, effects, ML, load, now, new_q, new_v, mode, stuck, table, before, out
        )
        before = found[k, 0]
    new_q, new_v = qs[4].copy(), vs[4].copy()
    error = step_error(h, a, found[3, 0], found[4, 0], fast, tolerance)
    return new_q, new_v, error, found[4].copy(), M


@compiled
def smooth_steps(
    q,
    v,
    found,
    M,
    step,
    span,
    tau,
    rate,
    mode,
    stuck,
    barred,
    watched,
    way,
    fast,
    rules,
    tree,
    bodies,
    armature,
    loaded,
    table,
):
    """Do explicit steps to the end of a span, or to where one of them is not enough."""
    # q, v, found (5, nv), M: state and what `accelerate` wrote there; step: length of
    # the next one [s]; span: its beginning, end and least step, after the last sample
    # [s]; tau, rate (nv,): torques there and their change in a second; barred (nv,):
    # joints that stick until they are pushed loose; watched, way, fast (nv,): as of
    # `Integrator`; rules: constants. Stiff steps, and those that pass an event, are
    # left to others. tree, table: plain tuples, which are faster to pass.
    table = _terms.TermArrays(*table)
    robot = Tree(*tree), bodies, armature, loaded, table
    stiff, tolerance, reserve, shrink, grow, holds, loose = rules
    done, end, least = span
    count = 0
    while end - done > least:
        left = end - done
        h = max(left if step >= left else min(step, 0.5 * left), least)
        if is_stiff(h, M, found[3], found[4], stuck, stiff):
            break
        now = tau + done * rate
        new_q, new_v, error, new_found, new_M = explicit_step(
            q, v, found[0], now, rate, h, mode, stuck, fast, tolerance, robot
        )
        grown = reserve * max(error, 1e-12) ** -0.25
        if not error <= 1:
            if h <= least:
                break
            step = h * (max(grown, shrink) if grown < 1 else shrink)
            continue
        exact = tolerance * fast
        past = past_events(
            watched, way, new_v, exact, barred, new_found[1], new_found[2], holds, loose
        )
        if np.max(past) > 0:
            break
        longer = h * min(grown, grow)
        step = max(longer, step) if step > h else longer
        q, v, found, M = new_q, new_v, new_found, new_M
        for j in range(q.size):
            if stuck[j]:
                v[j] = 0.0
            fast[j] = max(fast[j], abs(v[j]))
        remember(table.kinds, table.joints, table.numbers, table.memory, q, v)
        way = directions(v, found[0])
        done += h
        count += 1
    return q, v, found, M, done, step, way, count
