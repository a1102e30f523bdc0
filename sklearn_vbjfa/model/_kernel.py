"""Regressor rows of many samples, compiled by Numba.

Bodies and joints are seen in the world's axes, as in `sklearn_vbjfa.model._dynamics`.
Each sample goes through the tree once: a body's forces and moments by its ten
parameters are projected on the joint that moves it and on those that carry that joint.
"""

import math

import numpy as np

from sklearn_vbjfa._core._compiler import compiler

compiled = compiler(__file__)
inlined = compiler(__file__, inline="always")


@compiled
def vector(x):
    return x[0], x[1], x[2]


@compiled
def cross(x, y):
    return (
        x[1] * y[2] - x[2] * y[1],
        x[2] * y[0] - x[0] * y[2],
        x[0] * y[1] - x[1] * y[0],
    )


@compiled
def dot(x, y):
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@compiled
def scaled(a, x):
    return a * x[0], a * x[1], a * x[2]


@compiled
def axpy(a, x, y):
    """Return a x + y."""
    return a * x[0] + y[0], a * x[1] + y[1], a * x[2] + y[2]


@compiled
def combine(a, x, y, z):
    """Return a_1 x + a_2 y + a_3 z."""
    return (
        a[0] * x[0] + a[1] * y[0] + a[2] * z[0],
        a[0] * x[1] + a[1] * y[1] + a[2] * z[1],
        a[0] * x[2] + a[1] * y[2] + a[2] * z[2],
    )


@compiled
def turn(axis, cosine, sine):
    """Return the axes of a frame turned about an axis, in that frame, by rows."""
    u, v, w = axis
    rest = 1.0 - cosine
    x, y, z = rest * u, rest * v, rest * w
    return (
        (x * u + cosine, x * v + w * sine, x * w - v * sine),
        (y * u - w * sine, y * v + cosine, y * w + u * sine),
        (z * u + v * sine, z * v - u * sine, z * w + cosine),
    )


@compiled
def get(state, at):
    return state[at], state[at + 1], state[at + 2]


@compiled
def put(state, at, x):
    state[at], state[at + 1], state[at + 2] = x[0], x[1], x[2]


@inlined
def _forces_and_moments(p, x, y, z, field, w, dw):
    """Return a body's forces by m, mc, and moments about the origin by all ten."""
    # Acceleration of the tip of an axis relative to its tail: M e_k with
    # M = [dw]x + w w' - |w|^2, by its columns.
    square = dot(w, w)
    m1 = w[0] * w[0] - square, w[0] * w[1] + dw[2], w[0] * w[2] - dw[1]
    m2 = w[0] * w[1] - dw[2], w[1] * w[1] - square, w[1] * w[2] + dw[0]
    m3 = w[0] * w[2] + dw[1], w[1] * w[2] - dw[0], w[2] * w[2] - square
    dx = combine(x, m1, m2, m3)
    dy = combine(y, m1, m2, m3)
    dz = combine(z, m1, m2, m3)
    # A moment of inertia sums the squares of the other two coordinates, a product of
    # inertia is a mixed second moment times minus one.
    xx, yy, zz = cross(x, dx), cross(y, dy), cross(z, dz)
    half = combine((0.5, 0.5, 0.5), xx, yy, zz)
    moments = (
        cross(p, field),
        axpy(1.0, cross(p, dx), cross(x, field)),
        axpy(1.0, cross(p, dy), cross(y, field)),
        axpy(1.0, cross(p, dz), cross(z, field)),
        axpy(-1.0, xx, half),
        axpy(1.0, cross(dx, y), cross(dy, x)),
        axpy(-1.0, yy, half),
        axpy(1.0, cross(dx, z), cross(dz, x)),
        axpy(1.0, cross(dy, z), cross(dz, y)),
        axpy(-1.0, zz, half),
    )
    return (field, dx, dy, dz), moments


# What is kept of a body: its axes, origin, acceleration of the origin less gravity,
# angular velocity and acceleration, and its joint's screw.
ORIGIN, _FIELD, _SPEED, _GAIN, ANGULAR, LINEAR, STATE = 9, 12, 15, 18, 21, 24, 27


@inlined
def advance(known, tree, j, q, v, a):
    """Write what is kept of body j; return its forces and moments by parameters."""
    turns, slides, parent = tree.turns[j], tree.slides[j], tree.parents[j]
    if parent >= 0:
        above = known[parent]
        e1, e2, e3 = get(above, 0), get(above, 3), get(above, 6)
        p, field = get(above, ORIGIN), get(above, _FIELD)
        w, dw = get(above, _SPEED), get(above, _GAIN)
    else:
        e1, e2, e3 = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
        p, field, w = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        dw = vector(tree.base_angular)
    # Axes of the joint at zero, about or along one direction of which it moves.
    x = combine(vector(tree.frames[j, 0]), e1, e2, e3)
    y = combine(vector(tree.frames[j, 1]), e1, e2, e3)
    z = combine(vector(tree.frames[j, 2]), e1, e2, e3)
    direction = vector(tree.axes[j])
    axis = combine(direction, x, y, z)
    across = cross(w, axis)
    offset = combine(vector(tree.offsets[j]), e1, e2, e3)
    field = axpy(1.0, field, vector(tree.base[j]))
    if slides != 0.0:
        offset = axpy(slides * q, axis, offset)
        field = axpy(2.0 * slides * v, across, field)
        field = axpy(slides * a, axis, field)
    p = axpy(1.0, p, offset)
    field = axpy(1.0, cross(w, cross(w, offset)), field)
    field = axpy(1.0, cross(dw, offset), field)
    if turns != 0.0:
        angle = turns * q
        turned = turn(direction, math.cos(angle), math.sin(angle))
        x, y, z = (
            combine(turned[0], x, y, z),
            combine(turned[1], x, y, z),
            combine(turned[2], x, y, z),
        )
        w = axpy(turns * v, axis, w)
        dw = axpy(turns * a, axis, axpy(turns * v, across, dw))
    own = known[j]
    put(own, 0, x)
    put(own, 3, y)
    put(own, 6, z)
    put(own, ORIGIN, p)
    put(own, _FIELD, field)
    put(own, _SPEED, w)
    put(own, _GAIN, dw)
    angular = scaled(turns, axis)
    put(own, ANGULAR, angular)
    put(own, LINEAR, axpy(slides, axis, cross(p, angular)))
    return _forces_and_moments(p, x, y, z, field, w, dw)


@compiled
def fill(states, tree, places, out):
    """Write entries of regressor matrices in states (n, 3 nv) into rows (n, k)."""
    # places (nv, nv, 10): column of `out` for each torque, body and parameter, -1 for
    # none. Columns without an entry are left alone.
    nv = tree.parents.size
    known = np.zeros((nv, STATE))
    for state, row in zip(states, out):
        for j in range(nv):
            now = state[j], state[nv + j], state[2 * nv + j]
            forces, moments = advance(known, tree, j, now[0], now[1], now[2])
            # The joint itself and all those above it.
            i = j
            while i >= 0:
                angular, linear = get(known[i], ANGULAR), get(known[i], LINEAR)
                for k in range(10):
                    at = places[i, j, k]
                    if at >= 0:
                        torque = dot(angular, moments[k])
                        if k < 4:
                            torque += dot(linear, forces[k])
                        row[at] = torque
                i = tree.parents[i]


@inlined
def wrench(body, forces, moments):
    """Return the force and the moment that a body (10,) takes."""
    force = moment = (0.0, 0.0, 0.0)
    for k in range(10):
        moment = axpy(body[k], moments[k], moment)
        if k < 4:
            force = axpy(body[k], forces[k], force)
    return force, moment


@compiled
def torques(states, tree, bodies, out):
    """Write the torques (n, nv) of bodies (nv, 10) in states (n, 3 nv)."""
    nv = tree.parents.size
    known, carried = np.zeros((nv, STATE)), np.empty((nv, 6))
    for state, row in zip(states, out):
        for j in range(nv):
            now = state[j], state[nv + j], state[2 * nv + j]
            forces, moments = advance(known, tree, j, now[0], now[1], now[2])
            force, moment = wrench(bodies[j], forces, moments)
            put(carried[j], 0, force)
            put(carried[j], 3, moment)
        for j in range(nv - 1, -1, -1):
            force, moment = get(carried[j], 0), get(carried[j], 3)
            row[j] = dot(get(known[j], LINEAR), force)
            row[j] += dot(get(known[j], ANGULAR), moment)
            parent = tree.parents[j]
            if parent >= 0:
                for k in range(6):
                    carried[parent, k] += carried[j, k]
