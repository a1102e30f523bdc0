"""Shared fitted searches; the report of every fit is checked for consistency."""

import pytest

from tests.diagnosis.report._consistent import assert_consistent


@pytest.fixture(autouse=True, scope="session")
def consistent_reports():
    """Check the report of each fitted search."""
    from sklearn_vbjfa import EffectDiscovery

    fit = EffectDiscovery.fit

    def fit_and_check(self, *args, **options):
        discovery = fit(self, *args, **options)
        assert_consistent(discovery.report_)
        return discovery

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(EffectDiscovery, "fit", fit_and_check)
        yield


# Tests must not modify these fixtures.


@pytest.fixture(scope="session")
def springy(once):
    """Search `SPRINGY`, a recording with a spring on the first joint."""
    from tests.diagnosis._recordings import SPRINGY

    return once("springy", lambda: SPRINGY.search())


@pytest.fixture(scope="session")
def complete(once):
    """Search a recording without missing effects."""
    from tests.diagnosis._recordings import COMPLETE

    return once("complete", lambda: COMPLETE.search())


@pytest.fixture(scope="session")
def two_motions(once):
    """Search two recordings without missing effects, "slow" and "fast"."""
    from tests.diagnosis._recordings import TWO_MOTIONS

    return once("two_motions", lambda: TWO_MOTIONS.search())
