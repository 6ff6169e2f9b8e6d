"""`rig config`: the ready configs, listed and copied."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import rig

from rig.config import ready


def test_each_ready_config_says_in_a_sentence_what_it_is_for() -> None:
    listed = rig("config", "list").output.splitlines()
    assert [line.split()[0] for line in listed] == list(ready.names())
    assert "demo" in ready.names() and "uno" in ready.names()
    for name in ready.names():
        assert len(ready.purpose(name)) > 20, name
    assert ready.purpose("encoder").endswith("the edges at D2 and D3"), "a sentence may take two lines"


def test_a_copy_is_the_config_and_never_replaces_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert rig("config", "copy", "simulated.yaml").exit_code == 0
    copied = tmp_path / "simulated.yaml"
    assert copied.read_text(encoding="utf-8") == ready.text("simulated")
    copied.write_text("mine\n", encoding="utf-8")
    refused = rig("config", "copy", "simulated")
    assert (refused.exit_code, copied.read_text(encoding="utf-8")) == (2, "mine\n")
    assert "is there already" in refused.stderr


def test_a_name_that_is_not_there_gets_the_nearest() -> None:
    refused = rig("config", "copy", "smulated")
    assert refused.exit_code == 2
    assert "did you mean simulated?" in refused.stderr
