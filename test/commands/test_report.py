# SPDX-License-Identifier: Apache-2.0
"""``needle_sim report``: one page that holds everything, as a browser shows it."""

import base64
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser

import pytest
from PIL import Image

from needle_sim_ros.cli import main
from needle_sim_ros.view.page import Page
from needle_sim_ros.view.style import PROCESSES

BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
_VOID = {"meta", "img"}


class Strict(HTMLParser):
    """Refuses tags that are not closed in order; collects what the page refers to."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.images, self.links, self.text = [], [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        values = dict(attrs)
        if tag == "img":
            assert values["alt"].strip()
            self.images.append(values["src"])
        self.links += [v for k, v in attrs if k in ("href", "src", "action")]
        if tag not in _VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def report(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    page, result = folder / "report.html", folder / "report.json"
    arguments = [f"{recorded}/bag", "--output", f"{page}", "--json", f"{result}", "--replay"]
    assert main(["report", *arguments]) == 0
    return page, json.loads(result.read_text())


def test_the_page_is_well_formed_and_needs_nothing_from_outside(report):
    text = report[0].read_text(encoding="utf-8")
    page = Strict(text)
    assert len(page.images) == 2  # the session, and the replay over it
    assert all(link.startswith("data:image/svg+xml;base64,") for link in page.links)
    for image in page.images:
        svg = ElementTree.fromstring(base64.b64decode(image.partition(",")[2]))
        assert svg.tag.endswith("}svg")
    assert "script" not in page.tags and "link" not in page.tags
    without_images = re.sub(r'src="data:[^"]*"', "", text)
    assert "http://" not in without_images and "https://" not in without_images


def test_the_page_says_what_the_session_holds(report, recorded):
    page, result = report
    text = "".join(Strict(page.read_text()).text)
    for said in ("gao2016", "peak base force, insertion", "tick, median", "youngs_modulus"):
        assert said in text, said
    assert result["summary"]["tick_median_s"] > 0
    assert {entry["max_abs"] for entry in result["channels"].values()} == {0.0}


def test_what_a_session_says_is_text_and_never_markup():
    page = Page("<b>&")
    page.table([("<i>", '"><script>alert(1)</script>')], caption="</table>")
    page.preformatted("</pre><script>", "<s>")
    parsed = Strict(page.html())
    assert not {"script", "b", "i", "s"} & set(parsed.tags)
    assert '"><script>alert(1)</script>' in "".join(parsed.text)


def test_another_suffix_is_refused(recorded, tmp_path, capsys):
    assert main(["report", f"{recorded}/bag", "--output", f"{tmp_path}/a.txt"]) == 2
    assert "must end in .html" in capsys.readouterr().err


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
def test_a_browser_shows_the_pictures(report, tmp_path):
    shot = tmp_path / "shot.png"
    quiet = "--no-first-run --disable-background-networking --disable-component-update"
    subprocess.run(
        [
            *(BROWSER, "--headless", "--no-sandbox", "--disable-gpu", *quiet.split()),
            *("--disable-sync", "--host-resolver-rules=MAP * ~NOTFOUND"),
            *(f"--user-data-dir={tmp_path}/profile", "--window-size=1000,3000"),
            *(f"--screenshot={shot}", report[0].as_uri()),
        ],
        check=True,
        capture_output=True,
        timeout=60,
    )
    picture = Image.open(shot).convert("RGB")
    assert picture.size == (1000, 3000)
    colours = {colour: count for count, colour in picture.getcolors(1 << 24)}
    for name in ("insertion", "hold", "retraction"):
        band = tuple(bytes.fromhex(PROCESSES[name].band[1:]))
        assert colours.get(band, 0) > 1000, f"the band of {name} is not to be seen"
