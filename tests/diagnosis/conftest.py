"""Every report that a search makes in these tests agrees with itself."""

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
