"""Draws research/figures/report_page.png: the page of a map of climbs up a pole, and a replay, in a headless Chromium.

python research/page_picture.py [FOLDER]     # of study=pole_map, which is finished there
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from sweep.cli.main import main

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "report"))
from browser import Browser  # pyright: ignore[reportMissingImports]

PATH = Path(__file__).parent / "figures" / "report_page.png"
WIDTH, HEIGHT = 1360, 900
REPLAYS, TIME = 20, 20.9  # s, when the pole is gripped by all six feet
SCRUBBED = f"""(() => {{ const scrub = document.querySelector("#scrub"); scrub.value = {TIME};
    scrub.dispatchEvent(new Event("input", {{bubbles: true}})) }})()"""
SCROLLED = """document.querySelector("#explore").scrollIntoView({block: "start", behavior: "instant"});
    new Promise((done) => setTimeout(done, 1000))"""  # until what came into sight is drawn


def draw(page: Path) -> None:
    """The map, what is replayed, and what goes with that, of a report."""
    with TemporaryDirectory() as profile:
        browser = Browser(Path(profile), WIDTH, HEIGHT)
        browser.open(page)
        browser.until("document.querySelectorAll('.history').length")
        browser.run(SCRUBBED)
        browser.run(SCROLLED)
        browser.picture(PATH)
        browser.close()
    Image.open(PATH).convert("RGB").quantize(128).save(PATH, optimize=True)


def made(folder: Path) -> Path:
    """The report of the study in `folder`, which is run as far as it is missing."""
    for words in (["run", "study=pole_map", f"out={folder}"], ["report", str(folder), "--replays", str(REPLAYS)]):
        if code := main(words):
            raise SystemExit(code)
    return folder / "report.html"


if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        draw(made(Path(sys.argv[1] if sys.argv[1:] else folder)))
    print(PATH)
