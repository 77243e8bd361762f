"""The notebooks run from top to bottom, and show pictures."""

import nbformat
import pytest
from conftest import ROOT
from nbclient import NotebookClient

NOTEBOOKS = sorted((ROOT / "tutorials" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_from_top_to_bottom_and_shows_a_film(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)  # kept without what one machine printed
    resources = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(notebook, timeout=200, startup_timeout=200, resources=resources).execute()
    shown = [output.data for cell in notebook.cells for output in cell.get("outputs", ()) if "data" in output]
    assert any("<animateTransform" in data.get("text/html", "") for data in shown)
