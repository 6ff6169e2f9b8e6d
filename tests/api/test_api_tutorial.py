"""The tutorial runs from its first cell to its last, and is kept without what its cells have printed."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

TUTORIAL = Path(__file__).resolve().parents[2] / "docs" / "tutorial.ipynb"


@pytest.mark.evidence
@pytest.mark.filterwarnings("default")  # those of the notebook's machinery are not ours
def test_the_tutorial_runs(tmp_path: Path) -> None:
    notebook = nbformat.read(TUTORIAL, as_version=4)
    NotebookClient(notebook, timeout=None, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    shown = {kind for cell in notebook.cells for output in cell.get("outputs", ()) for kind in output.get("data", ())}
    assert {"image/png", "text/html"} <= shown
    last = [cell for cell in notebook.cells if cell.cell_type == "code"][-2:]
    assert [output.data["text/plain"] for output in last[0].outputs] == ["True"]
    assert len(list((tmp_path / "runs").iterdir())) == 3


def test_the_tutorial_is_kept_without_outputs() -> None:
    for cell in nbformat.read(TUTORIAL, as_version=4).cells:
        assert not cell.get("outputs"), "clear the outputs before you commit: jupyter nbconvert --clear-output"
        assert cell.get("execution_count") is None
