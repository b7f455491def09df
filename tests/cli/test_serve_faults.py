"""`framekit serve --faults`: a fault plan on a real port, and plans that a protocol cannot carry out."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli.test_serve import M100_IS_1234, READ_M100, ask, ended, line_of, opened, serving

from framekit.cli.main import main

PLAN = """
faults: flaky
rules:
  - {fault: wrong_check, every: 2}
  - {fault: error_reply, every: 3, code: 4}
"""


def test_a_plan_on_a_pseudo_terminal(tmp_path: Path) -> None:
    plan = tmp_path / "flaky.faults.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    words = ("mldp", "--port", "pty:", "--set", "M100=0x1234", "--faults", str(plan), "--quiet")
    with serving(*words) as process:
        path = line_of(process).split(" on ")[1].split()[0]
        with opened(path) as line:
            assert ask(line, READ_M100, 17) == M100_IS_1234
            second = ask(line, READ_M100, 17)
            assert second[:-2] == M100_IS_1234[:-2] and second != M100_IS_1234, "only its check is wrong"
            assert ask(line, READ_M100, 13)[:1] + b"" == b"\x15", "refused"
        ended(process)


def test_a_plan_that_does_not_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = tmp_path / "flaky.faults.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    assert main(["serve", "modbus-tcp", "--port", "tcp://127.0.0.1:0", "--faults", str(plan)]) == 1
    message = "flaky.faults.yaml:4:5: 'modbus-tcp' has no check code that could be wrong – leave this rule out"
    assert message in capsys.readouterr().err
    assert main(["serve", "mldp", "--port", "tcp://127.0.0.1:0", "--faults", "nothing"]) == 2
    assert "there is no fault plan 'nothing'" in capsys.readouterr().err
    assert main(["serve", "mldp", "--port", "tcp://127.0.0.1:0", "--faults", "nothing.yaml"]) == 2
    message = "nothing.yaml: there is no file 'nothing.yaml' – check its name and folder"
    assert message in capsys.readouterr().err
