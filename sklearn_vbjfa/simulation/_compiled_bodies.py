"""Inertia matrix and nonlinear effects of a tree of bodies, compiled by Numba.

What Pinocchio computes as well (`crba` and `nonLinearEffects`), for the compiled steps
of an integration. Vectors are in the axes of the base, and moments about the origin of
the joint that a branch begins with: the inertia of composite bodies is then a sum.
"""

import math

import numpy as np

from sklearn_vbjfa.model._compiled import (
    axpy,
    combine,
    compiled,
    cross,
    dot,
    turn,
    vector,
)

# Rows of what is known of a body: its axes, origin, angular velocity and acceleration,
# acceleration of the origin less gravity, its joint's screw (angular and linear), force
# and moment of all that it carries, and their mass, first moments and inertia.
_AXES, _ORIGIN, _SPEED, _GAIN, _FIELD = 0, 9, 12, 15, 18
_ANGULAR, _LINEAR, _FORCE, _MOMENT = 21, 24, 27, 30
_MASS, _FIRST, _INERTIA = 33, 34, 37
_STATE = 46


@compiled
def _get(state, at):
    """Return three numbers from a place on."""
    return state[at], state[at + 1], state[at + 2]


@compiled
def _put(state, at, x):
    """Write three numbers from a place on."""
    state[at], state[at + 1], state[at + 2] = x[0], x[1], x[2]


@compiled
def _add(state, at, x):
    """Add three numbers from a place on."""
    state[at] += x[0]
    state[at + 1] += x[1]
    state[at + 2] += x[2]


@compiled
def _scaled(a, x):
    """Return a x."""
    return a * x[0], a * x[1], a * x[2]


@compiled
def _rows(body, x):
    """Inertia of a body (10,) about its joint times a vector in its own axes."""
    xx, xy, yy, xz, yz, zz = body[4], body[5], body[6], body[7], body[8], body[9]
    return (
        xx * x[0] + xy * x[1] + xz * x[2],
        xy * x[0] + yy * x[1] + yz * x[2],
        xz * x[0] + yz * x[1] + zz * x[2],
    )


@compiled
def bodies_at(q, v, tree, bodies, armature, M, h):
    """Write the inertia matrix M (nv, nv) and nonlinear effects h (nv,) at a state."""
    # bodies (nv, 10); armature (nv,): rotor inertias [kg m^2 or kg], which M includes;
    # h: torques at rest of the accelerations, gravity included.
    nv = q.size
    state = np.zeros((nv, _STATE))
    for j in range(nv):
        own, body, parent = state[j], bodies[j], tree.parents[j]
        turns, slides = tree.turns[j], tree.slides[j]
        if parent >= 0:
            above = state[parent]
            e1, e2, e3 = _get(above, 0), _get(above, 3), _get(above, 6)
            p, w = _get(above, _ORIGIN), _get(above, _SPEED)
            dw, field = _get(above, _GAIN), _get(above, _FIELD)
        else:
            e1, e2, e3 = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
            p, w = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            dw, field = vector(tree.base_angular), (0.0, 0.0, 0.0)
        x = combine(vector(tree.frames[j, 0]), e1, e2, e3)
        y = combine(vector(tree.frames[j, 1]), e1, e2, e3)
        z = combine(vector(tree.frames[j, 2]), e1, e2, e3)
        direction = vector(tree.axes[j])
        axis = combine(direction, x, y, z)
        if turns != 0.0:
            angle = turns * q[j]
            rows = turn(direction, math.cos(angle), math.sin(angle))
            x, y, z = (
                combine(rows[0], x, y, z),
                combine(rows[1], x, y, z),
                combine(rows[2], x, y, z),
            )
        offset = combine(vector(tree.offsets[j]), e1, e2, e3)
        offset = axpy(slides * q[j], axis, offset)
        p = axpy(1.0, p, offset)
        across = cross(w, axis)
        field = axpy(1.0, field, vector(tree.base[j]))
        field = axpy(1.0, cross(w, cross(w, offset)), field)
        field = axpy(1.0, cross(dw, offset), field)
        field = axpy(2.0 * slides * v[j], across, field)
        w = axpy(turns * v[j], axis, w)
        dw = axpy(turns * v[j], across, dw)
        _put(own, 0, x)
        _put(own, 3, y)
        _put(own, 6, z)
        _put(own, _ORIGIN, p)
        _put(own, _SPEED, w)
        _put(own, _GAIN, dw)
        _put(own, _FIELD, field)
        angular = _scaled(turns, axis)
        _put(own, _ANGULAR, angular)
        _put(own, _LINEAR, axpy(slides, axis, cross(p, angular)))
        # The body's own force and moment.
        mass, first = body[0], combine((body[1], body[2], body[3]), x, y, z)
        force = axpy(mass, field, cross(w, cross(w, first)))
        force = axpy(1.0, cross(dw, first), force)
        w_own = dot(x, w), dot(y, w), dot(z, w)
        dw_own = dot(x, dw), dot(y, dw), dot(z, dw)
        spun = axpy(1.0, cross(w_own, _rows(body, w_own)), _rows(body, dw_own))
        moment = axpy(1.0, cross(first, field), combine(spun, x, y, z))
        _put(own, _FORCE, force)
        _put(own, _MOMENT, axpy(1.0, cross(p, force), moment))
        # Its mass, first moments and inertia about the common origin.
        own[_MASS] = mass
        _put(own, _FIRST, axpy(mass, p, first))
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
    M[:] = 0.0
    for j in range(nv - 1, -1, -1):
        own, parent = state[j], tree.parents[j]
        angular, linear = _get(own, _ANGULAR), _get(own, _LINEAR)
        first = _get(own, _FIRST)
        h[j] = dot(angular, _get(own, _MOMENT)) + dot(linear, _get(own, _FORCE))
        # Momentum of all that the joint carries, at its unit velocity.
        momentum = axpy(own[_MASS], linear, cross(angular, first))
        spin = (
            dot(_get(own, _INERTIA), angular),
            dot(_get(own, _INERTIA + 3), angular),
            dot(_get(own, _INERTIA + 6), angular),
        )
        spin = axpy(1.0, spin, cross(first, linear))
        i = j
        while i >= 0:
            other = state[i]
            value = dot(_get(other, _ANGULAR), spin)
            value += dot(_get(other, _LINEAR), momentum)
            M[i, j] = value
            M[j, i] = value
            i = tree.parents[i]
        M[j, j] += armature[j]
        if parent >= 0:
            for k in range(_FORCE, _STATE):
                state[parent, k] += own[k]
