"""Time to first paint, brushing and replay speed of a report page: `python bench/page.py REPORT.html`.

In a headless Chromium, driven as in the tests.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "report"))
from browser import Browser  # pyright: ignore[reportMissingImports]

CLICKS, PLAYED = 50, 3  # s
PAINTED = """(() => { const paint = performance.getEntriesByName("first-contentful-paint")[0],
    map = performance.getEntriesByName("map")[0]; return paint && map && [paint.startTime, map.startTime] })()"""
FRAMES = """window.frames_ = []; window.last_ = performance.now();
(function next(now) { frames_.push(now - last_); last_ = now; requestAnimationFrame(next) })(last_)"""


def main_thread_seconds(browser: Browser) -> float:
    """Return the CPU time (s) of the page's main thread, which other processes do not lengthen."""
    return next(
        one["value"] for one in browser.send("Performance.getMetrics")["metrics"] if one["name"] == "TaskDuration"
    )


def main(page: Path) -> None:
    """Print ms to the first paint and to the map, of a frame while a quarter is brushed, and frames of a replay.

    The replay plays for `PLAYED` s after `CLICKS` rollouts were chosen.
    """
    with TemporaryDirectory() as profile:
        browser = Browser(Path(profile))
        browser.send("Performance.enable", timeDomain="threadTicks")
        browser.open(page)
        first, drawn = browser.until(PAINTED)
        left, top, width, height = browser.place("#map-over")
        browser.run(FRAMES)
        browser.drag(left + 0.3 * width, top + 0.3 * height, left + 0.7 * width, top + 0.7 * height, steps=30)
        frames = np.array(browser.run("frames_"))
        browser.key("Escape")
        for k in range(CLICKS):
            share = (k + 0.5) / CLICKS
            browser.click(left + 64 + share * (width - 78), top + 12 + (0.37 * k % 1) * (height - 60))
        browser.place("#scene-a")
        before = main_thread_seconds(browser)
        browser.run(f"frames_ = []; new Promise((done) => setTimeout(done, {1000 * PLAYED}))")
        played = np.array(browser.run("frames_"))
        busy = main_thread_seconds(browser) - before
        browser.close()
    print(f"first paint {first:.0f} ms, map {drawn:.0f} ms")
    print(
        f"{page.stat().st_size / 1e6:.2f} MB; replay after {CLICKS} clicks: {len(played) / PLAYED:.0f} frames/s, "
        f"{1e3 * busy / len(played):.1f} ms of the main thread each"
    )
    print(f"brush: median {np.median(frames):.0f} ms a frame, 90 % {np.quantile(frames, 0.9):.0f} ms")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
