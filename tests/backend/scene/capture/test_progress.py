# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the work is and how long it still takes, by a clock that the test turns."""

import pytest

from physhdr.backend.scene.capture.progress import Stages


class Work:
    """Stages that take what ``seconds`` says, whatever was expected; what was told on the way."""

    def __init__(self, expected: dict[str, float]) -> None:
        self.now, self.told = 0.0, []
        self.stages = Stages(expected, self.listen, lambda: self.now)

    def listen(self, report) -> None:
        self.told.append((self.now, report))

    def do(self, stage: str, seconds: float, steps: int = 10) -> None:
        self.stages.begin(stage, stage)
        for step in range(steps):
            self.now += seconds / steps
            self.stages.at((step + 1) / steps, stage)


def test_what_is_expected_and_happens_is_told_exactly():
    work = Work({"reading": 10.0, "matching": 30.0, "writing": 60.0})
    for stage, seconds in (("reading", 10.0), ("matching", 30.0), ("writing", 60.0)):
        work.do(stage, seconds)
    for now, report in work.told:
        assert report.fraction == pytest.approx(min(now / 100.0, 0.999), abs=1e-3)
        if report.seconds_left is not None:
            assert report.seconds_left == pytest.approx(100.0 - now, abs=0.1)
    assert work.told[0][1].seconds_left is None  # nothing is known before anything was done


def test_a_machine_that_is_half_as_fast_is_known_after_the_first_stage():
    work = Work({"reading": 10.0, "matching": 30.0, "writing": 60.0})
    work.do("reading", 20.0)
    work.stages.begin("matching", "matching")
    assert work.told[-1][1].seconds_left == pytest.approx(180.0)


def test_it_never_goes_back_though_a_stage_takes_ten_times_as_long():
    work = Work({"reading": 10.0, "matching": 30.0, "writing": 60.0})
    work.do("reading", 10.0)
    work.do("matching", 300.0)
    work.do("writing", 60.0)
    fractions = [report.fraction for _, report in work.told]
    assert fractions == sorted(fractions) and fractions[-1] < 1.0
    lefts = {now: report.seconds_left for now, report in work.told}
    assert lefts[160.0] == pytest.approx(150.0 + 60.0)  # half of what it takes, and the writing


def test_many_small_steps_are_not_all_told():
    work = Work({"reading": 1.0})
    work.do("reading", 1.0, steps=1000)
    assert len(work.told) <= 5
