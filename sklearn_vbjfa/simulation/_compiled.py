"""Bodies, accelerations and explicit steps of a simulation, compiled by Numba.

The friction laws are those of `sklearn_vbjfa.simulation._terms`. Rigid-body dynamics
equal `crba` and `nonLinearEffects` of Pinocchio: vectors are in the axes of the base,
and moments about the origin of the first joint of a branch, so that the inertia of
composite bodies is a sum.
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

# Offsets in the state of a body, after the values that `advance` writes: force, moment,
# mass, first moments and inertia of the composite body; length of the state.
_FORCE, _MOMENT, _MASS, _FIRST, _INERTIA = 27, 30, 33, 34, 37
_STATE_LENGTH = 46
_TINY = float(np.finfo(float).tiny)

compiled = compiler(__file__, _kernel.__file__, _terms.__file__)

_add_terms = compiled(_terms.add_terms)
remember = compiled(_terms.remember)
load_size = compiled(_terms.load_size)


@compiled
def step_error(h, a1, a4, a5, fast, tolerance):
    """Error of an explicit step relative to the tolerance; nan if not a number."""
    # a1, a4, a5 (nv,): accelerations at the start, at the last stage, and at the end of
    # the step; fast (nv,): largest speeds so far.
    largest = 0.0
    for j in range(a1.size):
        error = abs(a4[j] - a5[j]) / (tolerance * max(fast[j], h * abs(a1[j])))
        largest = error if error > largest or error != error else largest
    return (h / 6.0) * largest


@compiled
def is_stiff(h, mass, by_position, by_velocity, stuck, most):
    """Return True if friction or springs are too stiff for an explicit step h."""
    rate = stiffness = 0.0
    for j in range(stuck.size):
        if not stuck[j]:
            rate = max(rate, abs(by_velocity[j] / mass[j, j]))
            stiffness = max(stiffness, abs(by_position[j] / mass[j, j]))
    return h * max(rate, math.sqrt(stiffness)) > most


@compiled
def directions(v, a):
    """Directions of motion (nv,): signs of velocities, or of accelerations at rest."""
    out = np.sign(v)
    for j in range(v.size):
        if v[j] == 0.0:
            out[j] = np.sign(a[j])
    return out


@compiled
def event_excess(watched, sign, v, zero, stuck, needed, limit, factor, tolerance):
    """Distance of joints past an event, relative to the tolerance, (nv,)."""
    # Sliding joints reverse; zero (nv,): velocities that count as zero. Sticking
    # joints break away at `factor` times the limit of their dry friction, up to
    # `tolerance`. Negative before the event, -inf for joints without events.
    out = np.full(v.size, -np.inf)
    for j in range(v.size):
        if stuck[j]:
            excess = abs(needed[j]) - factor * limit[j]
            out[j] = excess / max(tolerance * limit[j], _TINY)
        elif watched[j]:
            out[j] = -sign[j] * v[j] / zero[j]
    return out


@compiled
def bodies_at(q, v, tree, bodies, armature, M, h):
    """Write the inertia matrix M (nv, nv) and nonlinear effects h (nv,) at a state."""
    # bodies (n, 10): of all joints, followers included; armature (nv,): rotor inertias
    # [kg m^2 or kg], included in M; h: torques at zero acceleration, with gravity.
    n, leads = tree.parents.size, tree.leads
    state = np.zeros((n, _STATE_LENGTH))
    for j in range(n):
        row, body = state[j], bodies[j]
        lead, rate = int(leads[j, 0]), leads[j, 1]
        position = rate * q[lead] + leads[j, 2]
        forces, moments = advance(state, tree, j, position, rate * v[lead], 0.0)
        force, moment = wrench(body, forces, moments)
        put(row, _FORCE, force)
        put(row, _MOMENT, moment)
        x, y, z, p = get(row, 0), get(row, 3), get(row, 6), get(row, ORIGIN)
        mass, first = body[0], combine((body[1], body[2], body[3]), x, y, z)
        # Mass, first moments and inertia about the common origin.
        row[_MASS] = mass
        put(row, _FIRST, axpy(mass, p, first))
        tx = combine((body[4], body[5], body[7]), x, y, z)
        ty = combine((body[5], body[6], body[8]), x, y, z)
        tz = combine((body[7], body[8], body[9]), x, y, z)
        trace = mass * dot(p, p) + 2.0 * dot(p, first)
        for r in range(3):
            for c in range(3):
                value = x[r] * tx[c] + y[r] * ty[c] + z[r] * tz[c]
                value -= mass * p[r] * p[c] + p[r] * first[c] + first[r] * p[c]
                row[_INERTIA + 3 * r + c] = value
            row[_INERTIA + 4 * r] += trace
    M[:] = h[:] = 0.0
    for j in range(q.size):
        M[j, j] = armature[j]
    for j in range(n - 1, -1, -1):
        row, parent = state[j], tree.parents[j]
        lead, rate = int(leads[j, 0]), leads[j, 1]
        angular, linear = get(row, ANGULAR), get(row, LINEAR)
        first = get(row, _FIRST)
        torque = dot(angular, get(row, _MOMENT)) + dot(linear, get(row, _FORCE))
        h[lead] += rate * torque
        # Momentum of the composite body at unit velocity of the joint.
        momentum = axpy(row[_MASS], linear, cross(angular, first))
        spin = (
            dot(get(row, _INERTIA), angular),
            dot(get(row, _INERTIA + 3), angular),
            dot(get(row, _INERTIA + 6), angular),
        )
        spin = axpy(1.0, spin, cross(first, linear))
        i = j
        while i >= 0:
            ancestor = state[i]
            value = dot(get(ancestor, ANGULAR), spin)
            value += dot(get(ancestor, LINEAR), momentum)
            value *= leads[i, 1] * rate
            M[int(leads[i, 0]), lead] += value
            if i != j:
                M[lead, int(leads[i, 0])] += value
            i = tree.parents[i]
        if parent >= 0:
            for k in range(_FORCE, _STATE_LENGTH):
                state[parent, k] += row[k]


@compiled
def _solve(A, b):
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
def _constrain(A, b, stuck):
    """Replace the equations of sticking joints by zero acceleration."""
    n = b.size
    for j in range(n):
        if stuck[j]:
            # The column too, as rounding would move the joint.
            for c in range(n):
                A[j, c] = A[c, j] = 0.0
            A[j, j] = 1.0
            b[j] = 0.0


@compiled
def accelerate(M, h, ML, hL, tau, q, v, mode, stuck, table, before, out):
    """Write the accelerations at one state, see `ForwardDynamics.accelerate`."""
    # M, h, ML, hL: inertia matrix and nonlinear effects of the robot, and of the bodies
    # in the load; tau, q, v, mode, stuck (nv,): true torques, state, signs of dry
    # friction, sticking joints; before (nv,): previous accelerations; out: fields of
    # `StateSolution` (5, nv).
    nv = q.size
    lines, inertia, coupling = table.lines, table.inertia, table.coupling
    sums = np.zeros((7, nv))
    static, smooth, dry, load_smooth = sums[0], sums[1], sums[2], sums[3]
    by_position, by_velocity, load_by_position = sums[4], sums[5], sums[6]
    for i in range(nv):
        static[i], smooth[i] = lines[1, i], lines[0, i] * v[i]
        dry[i], by_velocity[i] = lines[2, i], lines[0, i] + coupling[i, i]
        for j in range(nv):
            static[i] += coupling[i, j] * v[j]
    _add_terms(table.kinds, table.joints, table.numbers, table.memory, q, v, sums)
    A, rhs = np.empty((nv, nv)), np.empty(nv)
    for i in range(nv):
        rhs[i] = tau[i] - h[i] - static[i] - smooth[i] - dry[i] * mode[i]
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
        load = constant + slope * L
        for _ in range(_terms.MOST_SIGNS):
            B = A.copy()
            for i in range(nv):
                gain = size[i] * slope[i]
                for j in range(nv):
                    B[i, j] += gain * ML[i, j]
                a[i] = rhs[i] - gain * hL[i] - size[i] * constant[i]
            _constrain(B, a, stuck)
            _solve(B, a)
            for i in range(nv):
                L[i] = hL[i]
                for j in range(nv):
                    L[i] += ML[i, j] * a[j]
            assumed = constant + slope * L
            constant, slope = load_size(L, lines[4], lines[5])
            load = constant + slope * L
            if (load == assumed).all():
                break
        for i in range(nv):
            rhs[i] -= size[i] * load[i]
            limit[i] += lines[3, i] * load[i]
            by_position[i] += load_by_position[i] * load[i]
    else:
        B = A.copy()
        _constrain(B, a, stuck)
        _solve(B, a)
    for i in range(nv):
        if stuck[i]:
            # Rounding would move the joint.
            a[i] = 0.0
    for i in range(nv):
        needed = rhs[i]
        for j in range(nv):
            needed -= A[i, j] * a[j]
        out[0, i], out[1, i], out[2, i] = a[i], needed, limit[i]
        out[3, i], out[4, i] = by_position[i], by_velocity[i]


@compiled
def explicit_step(q, v, a, tau, rate, h, mode, stuck, fast, tolerance, robot):
    # q, v, a: at the start; tau, rate (nv,): torques there and their time derivative;
    # h: step length [s]; fast (nv,): speeds that scale the tolerance; robot: tree,
    # bodies, armature, bodies in the load (nv, 10), table. Returns q, v at the end,
    # error relative to the tolerance, result of `accelerate` (5, nv), and M there.
    nv, (tree, bodies, armature, loaded, table) = q.size, robot
    M, ML, before = np.empty((nv, nv)), np.empty((nv, nv)), a
    effects, load = np.empty(nv), np.empty(nv)
    no_armature = np.zeros(nv)
    stages, torque = np.empty((5, 5, nv)), np.empty(nv)
    qs, vs = np.empty((5, nv)), np.empty((5, nv))
    for j in range(nv):
        vs[0, j], stages[0, 0, j] = v[j], a[j]
    for k in range(1, 5):
        # Two stages at the midpoint, one at the end, and the final state.
        step = 0.5 * h if k < 3 else h
        for j in range(nv):
            velocity, acceleration = vs[k - 1, j], stages[k - 1, 0, j]
            if k == 4:
                # Simpson's rule
                velocity = (vs[0, j] + 2.0 * (vs[1, j] + vs[2, j]) + velocity) / 6.0
                acceleration = 2.0 * (stages[1, 0, j] + stages[2, 0, j]) + acceleration
                acceleration = (stages[0, 0, j] + acceleration) / 6.0
            qs[k, j], vs[k, j] = q[j] + step * velocity, v[j] + step * acceleration
            torque[j] = tau[j] + step * rate[j]
        new_q, new_v, out = qs[k], vs[k], stages[k]
        bodies_at(new_q, new_v, tree, bodies, armature, M, effects)
        if table.of_load:
            bodies_at(new_q, new_v, tree, loaded, no_armature, ML, load)
        accelerate(
            M, effects, ML, load, torque, new_q, new_v, mode, stuck, table, before, out
        )
        before = stages[k, 0]
    new_q, new_v = qs[4].copy(), vs[4].copy()
    error = step_error(h, a, stages[3, 0], stages[4, 0], fast, tolerance)
    return new_q, new_v, error, stages[4].copy(), M


@compiled
def smooth_steps(
    q,
    v,
    values,
    M,
    step,
    span,
    tau,
    rate,
    mode,
    stuck,
    held,
    watched,
    sign,
    fast,
    rules,
    tree,
    bodies,
    armature,
    loaded,
    table,
):
    """Take explicit steps to the end of a span, or until another method is needed."""
    # q, v, values (5, nv), M: state and results of `accelerate` there; step: length of
    # the next step [s]; span: start, end and shortest step, relative to the last sample
    # [s]; tau, rate (nv,): torques there and their time derivative; held (nv,): joints
    # that stick until they break away; watched, sign, fast (nv,): see `Integrator`;
    # rules: constants. Stops before stiff steps and before events. tree, table: plain
    # tuples, which are faster to pass.
    table = _terms.TermArrays(*table)
    robot = Tree(*tree), bodies, armature, loaded, table
    stiff, tolerance, reserve, shrink, grow, factor, tol = rules
    time, end, least = span
    count = 0
    while end - time > least:
        remaining = end - time
        h = max(remaining if step >= remaining else min(step, 0.5 * remaining), least)
        if is_stiff(h, M, values[3], values[4], stuck, stiff):
            break
        torque = tau + time * rate
        new_q, new_v, error, new_values, new_M = explicit_step(
            q, v, values[0], torque, rate, h, mode, stuck, fast, tolerance, robot
        )
        grown = reserve * max(error, 1e-12) ** -0.25
        if not error <= 1:
            if h <= least:
                break
            step = h * (max(grown, shrink) if grown < 1 else shrink)
            continue
        zero = tolerance * fast
        excess = event_excess(
            watched, sign, new_v, zero, held, new_values[1], new_values[2], factor, tol
        )
        if np.max(excess) > 0:
            break
        longer = h * min(grown, grow)
        step = max(longer, step) if step > h else longer
        q, v, values, M = new_q, new_v, new_values, new_M
        for j in range(q.size):
            if stuck[j]:
                v[j] = 0.0
            fast[j] = max(fast[j], abs(v[j]))
        remember(table.kinds, table.joints, table.numbers, table.memory, q, v)
        sign = directions(v, values[0])
        time += h
        count += 1
    return q, v, values, M, time, step, sign, count
