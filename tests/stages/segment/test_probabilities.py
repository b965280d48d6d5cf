"""Softmax by groups against the plain one."""

import numpy as np
from scipy.special import softmax

from salpcc.schemas.labels import GROUP_OF_CLASS
from salpcc.stages.segment.probabilities import group_probabilities


def test_against_softmax() -> None:
    rng = np.random.default_rng(0)
    logits = rng.normal(0, 6, (5, 150, 19)).astype(np.float32)
    logits[0, :50] *= 100  # nothing but the first is left
    index = rng.integers(-1, 5, (5, 150)).astype(np.int32)
    groups, best = group_probabilities(logits, index, GROUP_OF_CLASS)
    plain = softmax(logits.astype(np.float64), axis=2)
    for group in range(3):
        of = np.flatnonzero(GROUP_OF_CLASS[1:20] == group)
        seen = index >= 0
        assert np.abs(groups[group] - plain[..., of].sum(2))[seen].max() < 1.1 / 8192
        found = np.take_along_axis(plain, best[group, ..., None] - (best[group, ..., None] > 0), 2)[..., 0]
        likely = seen & (plain[..., of].max(2) > 1e-30)
        assert np.isin(best[group][seen] - 1, of).all()
        assert np.allclose(found[likely], plain[..., of].max(2)[likely], rtol=1e-5)
        assert not groups[group, ~seen].any() and not best[group, ~seen].any()
