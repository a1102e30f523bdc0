"""Effects with a direction: what their mirror image explains as well has none."""

# A mirror image that saves more than this share of what the effect saves: most of what
# the effect explains is then what the two have in common.
_SHARE = 0.5


def one_sided(base, family, joints, score):
    """Restrict a scored family to one direction; `refuse_symmetric` otherwise.

    Parameters
    ----------
    base : SearchModel
        Model that the candidates come beside.
    family : Family
        Candidates whose class has an `Effect.opposite`.
    joints : list of int
        Joints that they act on.
    score : Score
        Their score.

    Returns
    -------
    family, score : Family and Score, or None and None
        Those of the better direction whose coefficients are plausible; None if there
        is none, or if the data do not tell the directions apart.

    Notes
    -----
    A direction is what `Effect.key` tells apart. To first order a delay of one signal
    is one of the other with the opposite sign, so that the better column may be the one
    that cannot be meant; those are left out before the best is chosen.
    """
    plausible = {
        id(effect)
        for effect, coef in zip(family.effects, score.coefs)
        if effect.plausible(coef)
    }
    kept = family.where(lambda one: id(one) in plausible)
    sides = {}
    for effect in kept.effects:
        if effect.key() not in sides:
            own = kept.like(effect)
            sides[effect.key()] = own, base.fitted.score(joints, own.columns)
    if not sides:
        return None, None
    chosen = max(sides, key=lambda side: sides[side][1].drop.max())
    own, found = sides[chosen]
    mirror = sides.get(own.effects[found.best].opposite().key())
    if mirror is not None:
        before, after, mirrored = (
            float((squares[:, joints] @ base.precision[joints]).sum())
            for squares in (base.squares, found.squares, mirror[1].squares)
        )
        if refuse_symmetric(before - after, before - mirrored):
            return None, None
    return own, found


def refuse_symmetric(saved, mirrored):
    """Whether a mirror image saves too much of the squared error beside the effect.

    A shift by d and its mirror image have the columns -d tau' + d^2 tau'' / 2 and
    d tau' + d^2 tau'' / 2: where most of what one saves is saved by the other as well,
    it is the even part that is found, a smoothing of one of the signals.

    Parameters
    ----------
    saved, mirrored : float
        What the effect and its mirror image take off the squared error.
    """
    return mirrored > _SHARE * saved
