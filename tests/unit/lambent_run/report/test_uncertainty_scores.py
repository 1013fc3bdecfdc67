"""How uncertainty and error go together is measured as statisticians do."""

import numpy as np
import pytest
from lambent_run.report.uncertainty_scores import rank_correlation
from scipy.stats import spearmanr


@pytest.mark.parametrize("levels", [3, 40, 10**6])
def test_the_rank_correlation_is_spearmans_also_with_ties(levels):
    rng = np.random.default_rng(levels)
    a = rng.integers(0, levels, 500).astype(np.float64)
    b = np.round(a + rng.normal(0.0, 0.5 * levels, 500))
    assert rank_correlation(a, b) == pytest.approx(spearmanr(a, b).statistic, abs=1e-12)
