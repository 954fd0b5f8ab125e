"""Outcomes are told apart, by colour for everybody and by shape."""

import json
from itertools import combinations
from pathlib import Path as File

import numpy as np
import pytest
from matplotlib.path import Path

from sweep.metrics.outcome import CAUSE_MEANINGS, FAILURE_MEANINGS, INVALID_CAUSES
from sweep.report.outcome_style import INVALID_CELL_COLOUR, OUTCOME_STYLES, UNKNOWN_KIND_STYLE, find_style, marker_path

# what eyes without one kind of cone see of linear red, green and blue (Machado and others 2009, severity 1)
EYES = {
    "all cones": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def lab(colour, eyes):
    """L, a and b of CIE 1976 as these eyes see a colour."""
    part = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    share = XYZ @ np.clip(np.asarray(EYES[eyes]) @ linear, 0, 1) / XYZ.sum(axis=1)
    f = np.where(share > 0.008856, np.cbrt(share), 7.787 * share + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("eyes", EYES)
def test_success_is_apart_from_every_failure(eyes):
    for cause in FAILURE_MEANINGS:
        away = np.linalg.norm(lab(find_style("success").colour, eyes) - lab(find_style(cause).colour, eyes))
        assert away >= 40, cause


def test_causes_that_a_study_shows_together_are_apart():
    """As cells of a map, whose glyphs are few; all studies of docs/, causes that 2 % of what failed there have."""
    pairs = set()
    for path in (File(__file__).parents[2] / "research" / "data").glob("*.json"):
        causes = json.loads(path.read_text(encoding="utf-8")).get("causes", {})
        frequent = {cause for cause, number in causes.items() if number >= 0.02 * sum(causes.values())}
        pairs |= set(combinations(sorted(frequent - set(INVALID_CAUSES)), 2))
    assert len(pairs) > 40
    for one, other in pairs:
        away = np.linalg.norm(lab(find_style(one).colour, "all cones") - lab(find_style(other).colour, "all cones"))
        assert away >= 20, (one, other)


def test_every_cause_has_a_colour_and_a_shape_of_its_own():
    assert set(OUTCOME_STYLES) == {"success", *CAUSE_MEANINGS}
    assert {find_style(cause).family for cause in FAILURE_MEANINGS} == {"foot", "body", "plan", "drive", "goal"}
    assert len({find_style(cause).colour for cause in FAILURE_MEANINGS}) == len(FAILURE_MEANINGS)
    assert len({look.shape.round(3).tobytes() for look in OUTCOME_STYLES.values()}) == len(OUTCOME_STYLES)
    for kind, look in OUTCOME_STYLES.items():
        assert np.hypot(*look.shape.T).max() <= 1.3, kind  # within its stamp
        for theme in (INVALID_CELL_COLOUR, "#1C2025"):  # seen on light and on dark
            assert (
                kind in INVALID_CAUSES or np.linalg.norm(lab(look.colour, "all cones") - lab(theme, "all cones")) > 25
            ), kind
    assert (
        find_style("a cause of another system")
        == find_style("a cause of another system")
        != UNKNOWN_KIND_STYLE
        == find_style("")
    )
    assert len(marker_path("slipped").vertices) == 4


def test_every_shape_is_seen_as_a_glyph():
    """None is so thin that it fades, and none of a family covers what another does, at the size that a map has them."""
    seen = {kind: covered(look.shape) for kind, look in OUTCOME_STYLES.items() if kind not in INVALID_CAUSES}
    for kind, one in seen.items():
        assert (one[1:-1, 1:-1] & one[:-2, 1:-1] & one[1:-1, :-2] & one[:-2, :-2]).sum() > 8, kind
        for other in seen.keys() - {kind}:
            if find_style(kind).family == find_style(other).family:
                assert (one ^ seen[other]).sum() > 0.2 * min(one.sum(), seen[other].sum()), (kind, other)


def covered(shape, radius=4.0):
    """Pixels whose middle a shape covers."""
    middles = (np.arange(11) - 5) / radius
    grid = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    return Path(np.concatenate([shape, shape[:1]]), closed=True).contains_points(grid).reshape(11, 11)
