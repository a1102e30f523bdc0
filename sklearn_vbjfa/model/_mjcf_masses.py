"""Mass and inertia of MJCF bodies: as they are given, or those of their shapes."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.model._mjcf_document import rotation_of_z
from sklearn_vbjfa.model._pinocchio import import_pinocchio

_DENSITY = 1000.0
# Shapes without mass, and how many sizes the others have.
_FLAT = ("plane", "hfield")
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}


@dataclass(frozen=True, kw_only=True, eq=False)
class Masses:
    """What a body consists of."""

    inertia: object  # in the body's axes; zero without mass
    # whether something of it has a mass that is not known, a mesh or a shell
    unknown: bool


def masses_of(document, body, shapes):
    """Return the `Masses` of a body."""
    # shapes: its geoms, and where the frames around them are in the body.
    how = document.compiler.text("inertiafromgeom", "auto")
    if how not in ("auto", "true", "false"):
        raise ValueError(f"<compiler> has inertiafromgeom={how[:60]!r}")
    inertial = body.find("inertial")
    if how == "false" or (how == "auto" and inertial is not None):
        return _given(document, inertial)
    low, high = document.compiler.numbers("inertiagrouprange", [0, 5], 2)
    counted = [
        (attributes, frame)
        for attributes, frame in shapes
        if low <= attributes.number("group") <= high
        and attributes.text("type", "sphere") not in _FLAT
    ]
    if not counted:
        return _given(document, inertial)
    return _of_shapes(document, counted)


def _given(document, element):
    """Return what an <inertial> says."""
    pin = import_pinocchio()
    if element is None:
        return Masses(inertia=pin.Inertia.Zero(), unknown=False)
    attributes = document.attributes(element)
    mass = attributes.number("mass")
    if mass < 0:
        raise ValueError(f"a body has the mass {mass:g} kg")
    placed = document.placement(attributes)
    full = attributes.numbers("fullinertia", None, 6)
    if full is not None:
        xx, yy, zz, xy, xz, yz = full
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        placed.rotation = np.eye(3)
    else:
        inertia = np.diag(attributes.numbers("diaginertia", np.zeros(3), 3))
    turned = placed.rotation @ inertia @ placed.rotation.T
    return Masses(
        inertia=_bounded(document, pin.Inertia(mass, placed.translation, turned)),
        unknown=False,
    )


def _of_shapes(document, shapes):
    """Add up the masses of a body's shapes."""
    pin = import_pinocchio()
    total, unknown = pin.Inertia.Zero(), False
    for attributes, frame in shapes:
        kind = attributes.text("type", "sphere")
        mass = attributes.numbers("mass", None, 1)
        if mass is not None and mass[0] == 0:
            continue
        if mass is None and attributes.number("density", _DENSITY) == 0:
            continue
        shell = attributes.truth("shellinertia", False)
        if kind not in _SIZES or attributes.text("mesh") is not None or shell:
            unknown = True
            continue
        total += _shape(document, attributes, kind).se3Action(frame)
    return Masses(inertia=_bounded(document, total), unknown=unknown)


def _shape(document, attributes, kind):
    """Return the inertia of one primitive in the axes around it."""
    pin = import_pinocchio()
    placed = document.placement(attributes)
    size = attributes.numbers("size", None, least=1)
    ends = attributes.numbers("fromto", None, 6)
    size = np.zeros(0) if size is None else size
    if ends is not None:
        begin, end = ends.reshape(2, 3)
        way = end - begin
        half = np.linalg.norm(way) / 2
        placed.translation = (begin + end) / 2
        placed.rotation = rotation_of_z(way / (2 * half)) if half > 0 else np.eye(3)
        across = size[:1]
        wide = kind in ("box", "ellipsoid")
        size = np.r_[across, across, half] if wide else np.r_[across, half]
    needed = _SIZES[kind]
    if size.size < needed or not (size[:needed] > 0).all():
        raise ValueError(
            f"{attributes.what} is a {kind}, whose size must be {needed} positive "
            "number(s)"
        )
    volume, moments = _solid(kind, *size[:needed])
    mass = attributes.numbers("mass", None, 1)
    mass = attributes.number("density", _DENSITY) * volume if mass is None else mass[0]
    if mass < 0:
        raise ValueError(f"{attributes.what} has the mass {mass:g} kg")
    turned = placed.rotation @ np.diag(mass * moments) @ placed.rotation.T
    return pin.Inertia(float(mass), placed.translation, turned)


def _solid(kind, *size):
    """Volume of a primitive, and its moments of inertia over its mass, (3,)."""
    if kind == "sphere":
        (r,) = size
        return 4 / 3 * np.pi * r**3, np.full(3, 0.4 * r**2)
    if kind in ("box", "ellipsoid"):
        squares = np.square(size)
        box = kind == "box"
        volume = (8 if box else 4 / 3 * np.pi) * np.prod(size)
        return volume, (squares.sum() - squares) / (3 if box else 5)
    r, h = size
    volume = 2 * np.pi * r**2 * h
    across, along = r**2 / 4 + h**2 / 3, r**2 / 2
    if kind == "capsule":
        # A cylinder, and a ball in two halves that are h away from the middle.
        ball = 4 / 3 * np.pi * r**3
        share = ball / (volume + ball)
        volume += ball
        across += share * (0.4 * r**2 + h**2 + 0.75 * h * r - across)
        along += share * (0.4 * r**2 - along)
    return volume, np.array([across, across, along])


def _bounded(document, inertia):
    """Apply what the compiler asks of masses and moments of inertia."""
    compiler = document.compiler
    least_mass = compiler.number("boundmass")
    least = compiler.number("boundinertia")
    balance = compiler.truth("balanceinertia", False)
    if not (least_mass or least or balance):
        return inertia
    mass = max(inertia.mass, least_mass)
    principal, axes = np.linalg.eigh(inertia.inertia)
    principal = np.maximum(principal, least)
    if balance and principal[0] + principal[1] < principal[2]:
        principal[:] = principal.mean()
    turned = axes @ np.diag(principal) @ axes.T
    return import_pinocchio().Inertia(float(mass), inertia.lever, turned)
