"""The notebook runs from its first cell to its last in a kernel of its own, shows what it says, and is stored without that."""

from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).parents[2] / "examples" / "tour.ipynb"


@pytest.fixture(scope="module")
def toured(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The notebook with all that its cells print and show."""
    notebook = pytest.importorskip("nbformat").read(NOTEBOOK, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)
    place = {"metadata": {"path": str(tmp_path_factory.mktemp("tour"))}}
    pytest.importorskip("nbclient").NotebookClient(notebook, resources=place).execute()
    return notebook


def test_the_tour_runs(toured: Any) -> None:
    outputs = [output for cell in toured.cells for output in cell.get("outputs", [])]
    assert any("5,760 points" in output.get("data", {}).get("text/html", "") for output in outputs)
    printed = [line for output in outputs for line in output.get("text", "").splitlines()]
    before, after = (int(n.replace(",", "")) for n in (printed[0].split()[0], printed[0].split()[-1]))
    assert after < 0.6 * before and "largest error" in printed[1]
    assert "float32 would change" in printed[2] and len(printed) == 3


def test_a_browser_shows_the_tour(toured: Any, tmp_path: Path, browser: Any) -> None:
    page = tmp_path / "tour.html"
    page.write_text(pytest.importorskip("nbconvert").HTMLExporter().from_notebook_node(toured)[0])
    browser.goto(page.as_uri(), wait_until="domcontentloaded")  # its fonts and formulas are of the web
    assert browser.locator("h1").first.inner_text().startswith("Archives of LiDAR scans")
    assert browser.locator(".jp-RenderedHTMLCommon table").first.is_visible()
    plot = browser.locator(".jp-RenderedImage img")
    assert plot.count() == 1 and plot.evaluate("image => image.naturalWidth") > 300
    browser.screenshot(path=tmp_path / "tour.png", full_page=True)
