"""The judge of the fault matrix: contacts, room to stop, true and untrue outcomes, the page's section."""

import sys

import numpy as np
import pytest

from support.paths import ROOT

pytestmark = pytest.mark.skipif(not (ROOT / "benchmarks").is_dir(), reason="not a checkout")


@pytest.fixture(scope="module")
def faults():
    sys.path.append(str(ROOT / "benchmarks"))
    return pytest.importorskip("faults")


@pytest.fixture(scope="module")
def judge(faults, tmp_path_factory):
    folder = tmp_path_factory.mktemp("corridor")
    faults.make_world(folder)
    return faults.Judge(folder, "cone-backup")


def along_x(until_m, speed_m_s=1.0, height_m=1.5):
    time = np.arange(0.0, until_m / speed_m_s, 0.05)
    return np.stack([time, speed_m_s * time, 0 * time, 0 * time + height_m], axis=1)


def test_a_contact_counts_where_a_stop_was_possible(judge):
    found = judge.figures(along_x(6.6), 3.0)  # the wall across is at x = 6.5 m
    assert found["contact"]
    assert found["could_stop"]
    assert found["room_m"] == pytest.approx(6.5 - 0.15 - 3.0, abs=0.1)
    assert found["moved_m"] == pytest.approx(3.6, abs=0.1)
    assert 0.5 < found["needed_m"] < 1.0  # a stop from 1 m/s takes 0.76 s


def test_there_is_no_room_to_stop_just_before_a_wall(judge):
    found = judge.figures(along_x(6.6), 5.9)
    assert found["contact"]
    assert not found["could_stop"]


def test_a_vehicle_that_is_wrong_about_its_velocity_cannot_be_stopped(judge):
    path = along_x(6.6)
    told = np.stack([path[::4, 0], 1.0 + 0 * path[::4, 0], 0 * path[::4, 0], 0 * path[::4, 0]], axis=1)
    assert judge.figures(path, 3.0, told)["could_stop"]
    told[:, 1] = -0.2
    found = judge.figures(path, 3.0, told)
    assert found["estimate_off_m_s"] == pytest.approx(1.2, abs=0.05)
    assert not found["could_stop"]


def test_a_fall_and_a_climb_are_measured(judge):
    path = along_x(4.0)
    path[60:, 3] -= 0.4
    path[70:, 3] += 1.0
    found = judge.figures(path, 2.9)
    assert not found["contact"]
    assert found["sank_m"] == pytest.approx(0.4)
    assert found["rose_m"] == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("fault", "code", "said", "is_true"),
    [
        ("fly killed", -9, "", True),
        ("fly killed", 0, "", False),
        ("radio lost", 6, "the flight ended early: vehicle's own failsafe (Radio Failsafe)", True),
        ("radio lost", 6, "the flight ended early: vehicle's own failsafe (Battery Failsafe)", False),
        ("radio lost", 0, "", False),
        ("mode BRAKE", 4, "the plan was not finished: mode changed by the pilot", True),
        ("mode BRAKE", None, "", False),
        ("wind of 3 m/s", 0, "written", True),
        ("wind of 3 m/s", 4, "the plan was flown, but off the plan", False),  # it was not
        ("wind of 3 m/s", 4, "the plan was flown, but the vehicle landed away from", False),  # 0.1 m
        ("wind of 3 m/s", 4, "the flight came closer to the map than the vehicle's radius", False),
        ("wind of 3 m/s", 6, "estimator not healthy", False),
    ],
)
def test_outcomes_are_compared_with_what_is_true(faults, judge, fault, code, said, is_true):
    row = {"code": code, "said": said, "contact": False, "strays": judge.strays(judge.course[::20])}
    row |= {"from_goal_m": 0.1, "least_m": 0.3}
    assert (faults.untrue(faults.FAULTS[fault], row) == "") is is_true


def test_a_path_off_the_plan_strays(judge):
    assert judge.strays(judge.course + np.array([0.0, 0.0, 3.0]))
    assert judge.strays(judge.course[:400])  # before the via point


def test_success_after_a_contact_is_untrue(faults):
    row = {"code": 0, "said": "", "contact": True, "strays": False}
    assert "after a contact" in faults.untrue(faults.FAULTS["wind of 3 m/s"], row)


def test_a_section_of_the_page_is_replaced_and_the_others_stay(faults):
    page = "# page\n\ntext\n\n## A\n\nold\n\n## B\n\nstays\n"
    assert faults.with_section(page, "## A\n\nnew\n") == "# page\n\ntext\n\n## A\n\nnew\n\n## B\n\nstays\n"
    assert faults.with_section(page, "## C\n\nmore\n") == page + "\n## C\n\nmore\n"


def test_notes_below_a_replaced_table_stay_if_they_are_to(faults):
    page = "# page\n\n## A\n\nold\n\n| 1 |\n| 2 |\n\nBy hand.\n\n## B\n\nstays\n"
    section = "## A\n\nnew\n\n| 3 |\n"
    kept = faults.with_section(page, section, keeps_notes=True)
    assert kept == "# page\n\n## A\n\nnew\n\n| 3 |\n\nBy hand.\n\n## B\n\nstays\n"
    assert faults.with_section(kept, section, keeps_notes=True) == kept
    assert "By hand" not in faults.with_section(page, section)
    empty = "# page\n\n## A\n\nold\n"
    assert faults.with_section(empty, section, keeps_notes=True) == f"# page\n\n{section}"
