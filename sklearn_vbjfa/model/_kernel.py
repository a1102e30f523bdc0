"""Regressor rows of many samples, compiled by Numba.

All vectors are in world axes, as in `sklearn_vbjfa.model._dynamics`. Each sample passes
the tree once: a body's forces and moments by its ten parameters are projected on the
joint that moves it and on all joints that carry that joint.
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
    """Return the axes, by rows, of a frame rotated about an axis of that frame."""
    u, v, w = axis
    versine = 1.0 - cosine
    x, y, z = versine * u, versine * v, versine * w
    return (
        (x * u + cosine, x * v + w * sine, x * w - v * sine),
        (y * u - w * sine, y * v + cosine, y * w + u * sine),
        (z * u + v * sine, z * v - u * sine, z * w + cosine),
    )


@compiled
def get(state, start):
    return state[start], state[start + 1], state[start + 2]


@compiled
def put(state, start, x):
    state[start], state[start + 1], state[start + 2] = x[0], x[1], x[2]


@inlined
def _forces_and_moments(p, x, y, z, accel, w, dw):
    """Return a body's forces by m and mc, and moments about the origin by all ten."""
    # Relative acceleration of the ends of an axis e_k: M e_k, with the columns of
    # M = [dw]x + w w' - |w|^2.
    square = dot(w, w)
    m1 = w[0] * w[0] - square, w[0] * w[1] + dw[2], w[0] * w[2] - dw[1]
    m2 = w[0] * w[1] - dw[2], w[1] * w[1] - square, w[1] * w[2] + dw[0]
    m3 = w[0] * w[2] + dw[1], w[1] * w[2] - dw[0], w[2] * w[2] - square
    dx = combine(x, m1, m2, m3)
    dy = combine(y, m1, m2, m3)
    dz = combine(z, m1, m2, m3)
    # A moment of inertia sums the second moments of the other two coordinates, a
    # product of inertia is a mixed second moment with negative sign.
    xx, yy, zz = cross(x, dx), cross(y, dy), cross(z, dz)
    half = combine((0.5, 0.5, 0.5), xx, yy, zz)
    moments = (
        cross(p, accel),
        axpy(1.0, cross(p, dx), cross(x, accel)),
        axpy(1.0, cross(p, dy), cross(y, accel)),
        axpy(1.0, cross(p, dz), cross(z, accel)),
        axpy(-1.0, xx, half),
        axpy(1.0, cross(dx, y), cross(dy, x)),
        axpy(-1.0, yy, half),
        axpy(1.0, cross(dx, z), cross(dz, x)),
        axpy(1.0, cross(dy, z), cross(dz, y)),
        axpy(-1.0, zz, half),
    )
    return (accel, dx, dy, dz), moments


# Layout of a body's motion: axes, origin, acceleration of the origin minus gravity,
# angular velocity, angular acceleration, and angular and linear part of its screw.
ORIGIN, _ACCEL, _OMEGA, _ALPHA, ANGULAR, LINEAR, STATE = 9, 12, 15, 18, 21, 24, 27


@inlined
def advance(motions, tree, j, q, v, a):
    """Write the motion of body j; return its forces and moments by parameters."""
    turns, slides, parent = tree.turns[j], tree.slides[j], tree.parents[j]
    if parent >= 0:
        parent_body = motions[parent]
        e1, e2, e3 = get(parent_body, 0), get(parent_body, 3), get(parent_body, 6)
        p, accel = get(parent_body, ORIGIN), get(parent_body, _ACCEL)
        w, dw = get(parent_body, _OMEGA), get(parent_body, _ALPHA)
    else:
        e1, e2, e3 = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
        p, accel, w = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        dw = vector(tree.base_angular)
    # Axes of the joint at zero; it moves about or along a direction in these axes.
    x = combine(vector(tree.frames[j, 0]), e1, e2, e3)
    y = combine(vector(tree.frames[j, 1]), e1, e2, e3)
    z = combine(vector(tree.frames[j, 2]), e1, e2, e3)
    direction = vector(tree.axes[j])
    axis = combine(direction, x, y, z)
    coriolis = cross(w, axis)
    offset = combine(vector(tree.offsets[j]), e1, e2, e3)
    accel = axpy(1.0, accel, vector(tree.base[j]))
    if slides != 0.0:
        offset = axpy(slides * q, axis, offset)
        accel = axpy(2.0 * slides * v, coriolis, accel)
        accel = axpy(slides * a, axis, accel)
    p = axpy(1.0, p, offset)
    accel = axpy(1.0, cross(w, cross(w, offset)), accel)
    accel = axpy(1.0, cross(dw, offset), accel)
    if turns != 0.0:
        angle = turns * q
        turned = turn(direction, math.cos(angle), math.sin(angle))
        x, y, z = (
            combine(turned[0], x, y, z),
            combine(turned[1], x, y, z),
            combine(turned[2], x, y, z),
        )
        w = axpy(turns * v, axis, w)
        dw = axpy(turns * a, axis, axpy(turns * v, coriolis, dw))
    body = motions[j]
    put(body, 0, x)
    put(body, 3, y)
    put(body, 6, z)
    put(body, ORIGIN, p)
    put(body, _ACCEL, accel)
    put(body, _OMEGA, w)
    put(body, _ALPHA, dw)
    angular = scaled(turns, axis)
    put(body, ANGULAR, angular)
    put(body, LINEAR, axpy(slides, axis, cross(p, angular)))
    return _forces_and_moments(p, x, y, z, accel, w, dw)


@compiled
def fill(states, tree, indices, out):
    """Write entries of regressor matrices in states (n, 3 nv) into rows (n, k)."""
    # indices (nv, nv, 10): column of `out` for each torque, body and parameter, -1 for
    # none. Other columns are not changed.
    nv = tree.parents.size
    motions = np.zeros((nv, STATE))
    for state, row in zip(states, out):
        for j in range(nv):
            sample = state[j], state[nv + j], state[2 * nv + j]
            forces, moments = advance(motions, tree, j, sample[0], sample[1], sample[2])
            # The joint itself and all joints that carry it.
            i = j
            while i >= 0:
                angular, linear = get(motions[i], ANGULAR), get(motions[i], LINEAR)
                for k in range(10):
                    column = indices[i, j, k]
                    if column >= 0:
                        torque = dot(angular, moments[k])
                        if k < 4:
                            torque += dot(linear, forces[k])
                        row[column] = torque
                i = tree.parents[i]


@inlined
def wrench(body, forces, moments):
    """Return the force and moment that a body of parameters (10,) requires."""
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
    motions, wrenches = np.zeros((nv, STATE)), np.empty((nv, 6))
    for state, row in zip(states, out):
        for j in range(nv):
            sample = state[j], state[nv + j], state[2 * nv + j]
            forces, moments = advance(motions, tree, j, sample[0], sample[1], sample[2])
            force, moment = wrench(bodies[j], forces, moments)
            put(wrenches[j], 0, force)
            put(wrenches[j], 3, moment)
        for j in range(nv - 1, -1, -1):
            force, moment = get(wrenches[j], 0), get(wrenches[j], 3)
            row[j] = dot(get(motions[j], LINEAR), force)
            row[j] += dot(get(motions[j], ANGULAR), moment)
            parent = tree.parents[j]
            if parent >= 0:
                for k in range(6):
                    wrenches[parent, k] += wrenches[j, k]
