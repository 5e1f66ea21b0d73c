"""The report: a browser shows it without a complaint, and its numbers are those of run.json and the CSV files."""

import csv
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import pytest

BROWSER = next(filter(None, map(shutil.which, ["chromium", "chromium-browser", "google-chrome"])), None)
DARK = "--blink-settings=preferredColorScheme=0"
LIGHT = "--blink-settings=preferredColorScheme=1"


class Page(HTMLParser):
    """Elements and their attributes, exact numbers, and all that is loaded."""

    def __init__(self, text: str):
        super().__init__()
        self.numbers, self.loaded, self.ids, self.links = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        if tag == "data":
            self.numbers.append(attrs["value"])
        if tag in ("img", "image", "script", "iframe", "source"):
            self.loaded += [attrs[name] for name in ("src", "href") if name in attrs]
        if tag == "link":
            self.loaded.append(attrs["href"])
        if tag == "a":
            self.links.append(attrs["href"])
        if "id" in attrs:
            self.ids.append(attrs["id"])


@pytest.fixture(scope="module", params=["quickstart", "rockfall"])
def run(request):
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module")
def page(run):
    return Page((run.folder / "report.html").read_text(encoding="utf-8"))


def browse(run, *flags):
    """Opens the report; returns what the browser prints and complains of."""
    if BROWSER is None:
        pytest.skip("there is no Chromium")
    address = (run.folder / "report.html").as_uri()
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0", *flags, address]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=180)
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def test_it_is_small_enough_to_be_sent(run):
    assert (run.folder / "report.html").stat().st_size < 10_000_000


def test_nothing_is_loaded_from_elsewhere(page):
    assert all(address.startswith("data:") for address in page.loaded), [a[:60] for a in page.loaded]
    assert len(page.ids) == len(set(page.ids))


def test_links_lead_to_files_of_the_run_folder_or_places_of_the_page(page, run):
    for link in page.links:
        if link.startswith("#"):
            assert link[1:] in page.ids, link
        else:
            assert (run.folder / link).is_file(), link


def test_numbers_are_those_of_the_manifest(page, run):
    told = [metric["value"] for step in run.manifest["steps"] for metric in step["metrics"]]
    single = {step["step"]: 0 for step in run.manifest["steps"]}
    for step in run.manifest["steps"]:
        single[step["step"]] += 1
    shown = {float(number) for number in page.numbers}
    wanted = [
        metric["value"]
        for step in run.manifest["steps"]
        if single[step["step"]] == 1
        for metric in step["metrics"]
        if metric["value"] is not None
    ]
    assert told and wanted
    assert all(value in shown for value in wanted)


def test_numbers_are_those_of_the_tables(page, run):
    targets = {step["step"] for step in run.manifest["steps"]}
    shown = set(page.numbers)
    found = 0
    for step in run.manifest["steps"]:
        if step["step"] not in targets or step["point"]:
            continue
        for path in step["paths"].values():
            file = (run.folder / path).with_suffix(".csv")
            if not file.is_file():
                continue
            rows = list(csv.reader(file.open()))[1:13]
            cells = [cell for row in rows for cell in row if re.fullmatch(r"-?\d+(\.\d+)?", cell)]
            assert all(cell in shown for cell in cells), file
            found += len(cells)
    assert found > 0


@pytest.mark.parametrize("scheme", [LIGHT, DARK])
def test_a_browser_shows_it_without_complaint(run, scheme, tmp_path):
    picture = tmp_path / "page.png"
    _, complaints = browse(run, scheme, "--hide-scrollbars", "--window-size=1240,2000", f"--screenshot={picture}")
    assert complaints == []
    assert picture.stat().st_size > 20_000


def test_its_script_and_its_style_work(run):
    dom, complaints = browse(run, "--dump-dom")
    assert complaints == [] and 'id="steps"' in dom
    assert 'tabindex="0"' in dom, "tables can be sorted"


def test_it_prints(run, tmp_path):
    paper = tmp_path / "page.pdf"
    _, complaints = browse(run, "--no-pdf-header-footer", f"--print-to-pdf={paper}")
    assert complaints == [] and paper.read_bytes().startswith(b"%PDF") and paper.stat().st_size > 20_000


def test_a_report_made_later_says_the_same(binary, run, tmp_path):
    again = tmp_path / "again.html"
    store = run.folder.parents[1] / "store"
    command = [binary, "report", run.folder, "--store", store, "--output", again]
    subprocess.run(command, capture_output=True, check=True, timeout=60)
    first = Page((run.folder / "report.html").read_text(encoding="utf-8"))
    assert Page(again.read_text(encoding="utf-8")).numbers == first.numbers
    assert json.loads((run.folder / "run.json").read_text())["status"] == "done"
