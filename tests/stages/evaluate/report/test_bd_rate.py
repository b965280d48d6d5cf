"""Bjøntegaard's delta rate, on curves whose answer is known."""

from __future__ import annotations

import pytest

from salpcc.stages.evaluate.report.baseline_figures import bd_rates
from salpcc.stages.evaluate.report.bd_rate import bd_rate

CURVE = [(20.0, 1e-6), (13.0, 2.5e-5), (10.0, 1e-4), (7.0, 4e-4), (4.0, 2e-3)]


def test_twice_the_bits_is_a_hundred_percent_more() -> None:
    twice = [(2 * rate, distortion) for rate, distortion in CURVE]
    assert bd_rate(CURVE, twice) == pytest.approx(100.0)
    assert bd_rate(twice, CURVE) == pytest.approx(-50.0)
    assert bd_rate(CURVE, CURVE[::-1]) == pytest.approx(0.0)


def test_more_distortion_at_the_same_rate_costs() -> None:
    worse = [(rate, 3 * distortion) for rate, distortion in CURVE]
    found = bd_rate(CURVE, worse)
    assert found is not None and found > 5


def test_curves_that_do_not_meet_or_are_too_short_say_nothing() -> None:
    assert bd_rate(CURVE, [(rate, 1e3 + distortion) for rate, distortion in CURVE]) is None
    assert bd_rate(CURVE[:3], CURVE) is None


def test_codecs_are_compared_with_ours() -> None:
    def figures(scale: float) -> dict[str, dict[str, object]]:
        return {
            str(i): {"frames": 1, "bpp": {"geometry": scale * rate}, "d_d": distortion}
            for i, (rate, distortion) in enumerate(CURVE)
        }

    exact = {"0": {"frames": 1, "bpp": {"geometry": 70.0}, "d_d": 0.0}}
    rates = bd_rates({"salpcc": figures(1), "draco": figures(3), "xz": exact, "gone": {"0": {"frames": 0}}})
    assert rates == {"salpcc": {"draco": pytest.approx(200.0)}}
    assert bd_rates({"draco": figures(1)}) == {}


def test_tmc13_is_a_reference_where_it_ran() -> None:
    def figures(scale: float) -> dict[str, dict[str, object]]:
        return {
            str(i): {"frames": 1, "bpp": {"geometry": scale * rate}, "d_d": distortion}
            for i, (rate, distortion) in enumerate(CURVE)
        }

    rates = bd_rates({"salpcc": figures(1), "tmc13": figures(2)})
    assert rates == {"salpcc": {"tmc13": pytest.approx(100.0)}, "tmc13": {"salpcc": pytest.approx(-50.0)}}
