"""How soon a page is painted, and how fast a brush answers: `python bench/page.py results/walk_map/report.html`.

In a headless Chromium, driven as the tests do.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "report"))
from browser import Browser  # pyright: ignore[reportMissingImports]

PAINTED = """(() => { const paint = performance.getEntriesByName("first-contentful-paint")[0],
    map = performance.getEntriesByName("map")[0]; return paint && map && [paint.startTime, map.startTime] })()"""
FRAMES = """window.frames_ = []; window.last_ = performance.now();
(function next(now) { frames_.push(now - last_); last_ = now; requestAnimationFrame(next) })(last_)"""


def main(page: Path) -> None:
    """Print milliseconds to the first paint and to the map, and those of a frame while a quarter of it is brushed."""
    with TemporaryDirectory() as profile:
        browser = Browser(Path(profile))
        browser.open(page)
        first, drawn = browser.until(PAINTED)
        left, top, width, height = browser.place("#map-over")
        browser.run(FRAMES)
        browser.drag(left + 0.3 * width, top + 0.3 * height, left + 0.7 * width, top + 0.7 * height, steps=30)
        frames = np.array(browser.run("frames_"))
        browser.close()
    print(f"first paint {first:.0f} ms, map {drawn:.0f} ms")
    print(f"brush: median {np.median(frames):.0f} ms a frame, 90 % {np.quantile(frames, 0.9):.0f} ms")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
