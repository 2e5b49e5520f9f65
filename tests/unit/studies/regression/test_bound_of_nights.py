"""The bound of a frame beside the errors of a night, and baselines from before it was kept."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.studies.regression.baseline.baseline import from_columns, to_columns


def test_rows_carry_the_bound_of_their_frame(night):
    rows = [row for row in night.results().rows if row.is_claim]
    assert len(rows) > 5
    for row in rows:
        assert row.bound_arcsec is not None
        # Of 96 pixels over 110 deg with nothing known of the place: the flattening alone is 0.13 deg.
        assert 300.0 < row.bound_arcsec < 1500.0
        assert row.error_over_bound == pytest.approx(row.nadir_error_arcsec / row.bound_arcsec)
    # What no unbiased method undercuts in the mean square, one fit of a cone does not undercut by much.
    assert np.mean([row.error_over_bound**2 for row in rows]) > 0.3


def test_baselines_of_before_have_none(night):
    rows = night.results().rows
    assert from_columns(to_columns(rows)) == list(rows)
    columns = to_columns(rows)
    del columns["bound_arcsec"]
    before = from_columns(columns)
    assert len(before) == len(rows)
    assert all(row.bound_arcsec is None and row.error_over_bound is None for row in before)
    del columns["status"]
    with pytest.raises(KeyError):
        from_columns(columns)
