"""Take the pictures of the page of ``ccd-warp explore``: ``python docs/make_explore_pictures.py [FOLDER]``.

It needs a Chromium.
"""

import sys
import tempfile
from pathlib import Path

# the tests drive the page by the same browser
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))

from browser import find_browser, opened_browser

from ccd_warp._cli.explore import write_page

FIGURES = Path(__file__).parent / "figures"
WIDTH = 1200
# The first and the last element of each picture.
PICTURES = {
    "explore_bullet": ("#bullet-title", ".lanes"),
    "explore_pair": ("#pair-title", ".panels"),
}


def main() -> None:
    to = Path(sys.argv[1] if len(sys.argv) > 1 else FIGURES)
    browser = find_browser()
    if browser is None:
        sys.exit("no Chromium found: apt-get install chromium, or set CCD_WARP_BROWSER to its path")
    with tempfile.TemporaryDirectory() as folder, opened_browser(browser) as page:
        page.resize(WIDTH)
        page.set_theme("light")
        page.open(write_page(Path(folder) / "explore.html"))
        page.evaluate("setStep(41); setClip(2)")  # half-way: boxes that are free and open, and a line that separates
        page.wait_for_frame()
        for name, (first, last) in PICTURES.items():
            top = page.evaluate(f"document.querySelector('{first}').getBoundingClientRect().top + scrollY")
            bottom = page.evaluate(f"document.querySelector('{last}').getBoundingClientRect().bottom + scrollY")
            path = to / f"{name}.png"
            page.picture(path, clip=(0, top - 8, WIDTH, bottom - top + 16))
            print(f"{path.name}  {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
