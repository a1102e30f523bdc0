"""Fitted searches that several tests look at; each agrees with itself."""

import pytest

from tests.diagnosis.report._consistent import assert_consistent


@pytest.fixture(autouse=True, scope="session")
def consistent_reports():
    """Look at the report of each search that is fitted."""
    from sklearn_vbjfa import EffectDiscovery

    fit = EffectDiscovery.fit

    def fit_and_look(self, *args, **given):
        found = fit(self, *args, **given)
        assert_consistent(found.report_)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(EffectDiscovery, "fit", fit_and_look)
        yield


# Tests must not change what these return.


@pytest.fixture(scope="session")
def springy(once):
    """Search in the recording of a spring on the first joint, `SPRINGY`."""
    from tests.diagnosis._recordings import SPRINGY

    return once("springy", lambda: SPRINGY.search())


@pytest.fixture(scope="session")
def complete(once):
    """Search in a recording that lacks nothing."""
    from tests.diagnosis._recordings import COMPLETE

    return once("complete", lambda: COMPLETE.search())


@pytest.fixture(scope="session")
def two_motions(once):
    """Search in two recordings of a robot that lacks nothing, "slow" and "fast"."""
    from tests.diagnosis._recordings import TWO_MOTIONS

    return once("two_motions", lambda: TWO_MOTIONS.search())
