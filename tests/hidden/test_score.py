"""The judge of hidden-effect answers, on answers whose worth is plain."""

import math
from dataclasses import replace

import pytest

from tests.hidden.score import Score, judge, rows, score, share_found, summary, table


def finding(effect, *equivalents):
    return {"effect": effect, "equivalents": list(equivalents)}


@pytest.mark.parametrize(
    ("truth", "verdict", "findings", "result", "exact"),
    [
        (["backlash"], "named", [finding("backlash")], "right", True),
        (["backlash"], "named", [finding("flexible_coupling", "backlash")], "right", False),
        (["backlash"], "named", [finding("end_stop", "backlash", "a", "b", "c")], "abstained", False),
        (["backlash"], "nothing-missing", [], "abstained", False),
        (["backlash"], "named", [finding("backlash"), finding("end_stop")], "wrong", False),
        (["backlash", "end_stop"], "named", [finding("end_stop"), finding("backlash")], "right", True),
        (["backlash", "end_stop"], "named", [finding("end_stop", "backlash")], "abstained", False),
        (["none"], "nothing-missing", [], "right", True),
        (["none"], "named", [finding("end_stop")], "wrong", False),
        (["backlash", "unknown"], "partly-named", [finding("backlash")], "right", True),
        (["backlash", "unknown"], "named", [finding("backlash")], "abstained", False),
        (["backlash", "unknown"], "partly-named", [finding("backlash"), finding("end_stop")], "wrong", False),
        (["backlash"], "partly-named", [finding("backlash")], "abstained", False),
        (["unknown"], "unnamed", [], "right", True),
        (["unknown"], "nothing-missing", [], "abstained", False),
        (["unknown"], "named", [finding("end_stop")], "wrong", False),
    ],
)
def test_judge(truth, verdict, findings, result, exact):
    assert judge({"verdict": verdict, "findings": findings}, {"effects": truth})[:2] == (result, exact)


def test_an_answer_that_comes_too_late_is_wrong_and_has_its_row(tmp_path):
    (tmp_path / "truth.json").write_text('{"effects": ["backlash"]}')
    late = score(tmp_path, timeout=0.0)  # no process is that fast
    assert (late.result, late.named) == ("wrong", ())
    assert late.note == "no answer within 0 s"
    page = table([late], 0, "several", True, False)
    assert late.note in page
    assert str(tmp_path) not in page
    assert summary([late])["asked_for"]["of"] == len(late.seen) == 1  # not answered is not named


def test_an_effect_below_the_noise_is_too_small_to_ask_for():
    assert judge({"verdict": "nothing-missing", "findings": []}, {"effects": ["backlash"], "detectable": False}) == (
        "too small",
        False,
        (),
    )


def test_summary_and_page():
    scores = [
        Score(
            *("a", ("backlash",), ("backlash",), "named", "right", True, (), 0.98, 20.0),
            seen=("backlash",),
            claimed=("backlash",),
        ),
        Score("b", ("backlash",), ("end_stop",), "named", "wrong", False, ("end_stop",), 0.3, 30.0),
        Score("c", ("none",), (), "nothing-missing", "right", True, (), math.nan, 10.0),
        Score("d", ("unknown",), (), "unnamed", "right", True, (), math.nan, 10.0),
    ]
    count = summary(scores)
    assert (count["effects"], count["right"], count["wrong"], count["false_alarms"]) == (2, 1, 1, 0)
    assert count["unknown_right"] == count["unknown"] == 1
    assert (count["asked_for"]["count"], count["asked_for"]["of"]) == (1, 1)
    assert (count["false_names"]["count"], count["false_names"]["of"]) == (1, 2)
    page = table(scores, 4)
    assert "| backlash | 2 | 1 | 0 | 1 | backlash; end_stop |" in page
    assert "| none | 1 | 1 | 0 | 0 | nothing-missing |" in page
    assert "seed 4" in page
    assert "repeats its laps" in page
    assert "No training record repeats" in table(scores, 4, repeats=False)
    assert "Rules were chosen with these cases" in table(scores, 4, "several", steered=True)
    small = [replace(scores[0], share=0.1, claimed=()), scores[0]]
    assert share_found(small) == [(0.1, 0, 1), (1.0, 1, 1)]
    assert "| 0.1 | 0 | 1 | 0 to 79 % |" in table(small, 4, "small")
    assert [row["right"] for row in rows(scores)] == [True, False, True, True]
