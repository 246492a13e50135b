"""The verdict of a report in words, and what it says is guaranteed."""

import msgspec
import pytest

from alula.schemas.artifacts.manifest import Guarantee, InputRef
from alula.schemas.parameters.flight_defaults import NO_FILTER
from alula.stages.reporting.brief import brief
from alula.stages.reporting.material import Material, Run
from support.scenes.fabricate import box, make_cover, make_plan, make_record, make_trial

SAFE = [make_trial(i, clearance=0.5 - 0.1 * i) for i in range(3)]
STUCK = make_trial(3, "stuck", clearance=0.1)
HIT = make_trial(4, clearance=-0.02)
COVER = make_cover([box((0, 0, 0), (10, 10, 10))], summary={"voxels": 700})


def run_of(trials, label="a", claims=None, **fields):
    record = make_record(trials, **fields)
    if claims is not None:
        record = msgspec.structs.replace(record, guarantee=Guarantee("s", claims))
    return Run(label, record)


def said(*runs, **others):
    found = brief(Material("t", tuple(runs), **others))
    return found.verdict, found.tone


@pytest.mark.parametrize(
    ("trials", "verdict", "tone"),
    [
        (SAFE, "All 3 flights reached the goal and touched nothing.", "good"),
        ([*SAFE, STUCK], "None of 4 flights touched anything; 3 reached the goal.", "fair"),
        ([*SAFE, HIT], "1 of 4 flights touched an obstacle.", "bad"),
        (SAFE[:1], "The flight reached the goal and touched nothing.", "good"),
        ([STUCK], "The flight did not reach its goal (stuck) and touched nothing.", "fair"),
        ([HIT], "The flight touched an obstacle.", "bad"),
    ],
)
def test_the_verdict_says_what_was_touched_before_what_was_reached(trials, verdict, tone):
    assert said(run_of(trials)) == (verdict, tone)


def test_what_was_not_judged_is_not_called_clear():
    blind = [msgspec.structs.replace(trial, map_clearance_m=None, collision=False) for trial in SAFE]
    record = make_record(SAFE)
    run = Run("a", msgspec.structs.replace(record, trials=blind))
    assert said(run)[0] == "All 3 flights reached the goal; no obstacle was judged."
    both = brief(Material("t", (run, run_of(SAFE, "b"))))
    assert both.verdict == "None of 3 flights touched anything; 3 had no obstacle to judge."
    assert "min_clearance_m" not in [
        number.key for number in brief(Material("t", (run,))).subjects[0].numbers
    ]


def test_flights_without_a_filter_are_only_what_others_are_compared_with():
    bare = run_of([*SAFE, HIT], "bare", filter_name=NO_FILTER)
    assert said(bare) == ("Without a filter: 1 of 4 flights touched an obstacle.", "bad")
    assert said(run_of(SAFE), bare) == (
        "Behind a filter none of 3 flights touched anything; 3 reached the goal. "
        "Without one, 1 of 4 touched an obstacle.",
        "good",
    )
    assert said(run_of([*SAFE, HIT]), bare)[1] == "bad"


def test_flights_behind_different_filters_are_not_added_up():
    one, other = run_of(SAFE, "a"), run_of([*SAFE, STUCK], "b", filter_name="cone-di")
    assert said(one, other) == ("None of 7 flights in 2 runs touched anything.", "fair")
    assert said(one, run_of(SAFE, "b"))[0].endswith("; 6 reached the goal.")


def test_a_run_whose_log_was_cut_does_not_count_as_flown():
    cut = Run("b", msgspec.structs.replace(make_record(SAFE), trials=[], summary={"notes": ["cut"]}))
    words, _ = said(run_of(SAFE), cut)
    assert words == "None of 3 flights touched anything; 3 reached the goal. 1 run was not judged."


def test_the_closest_part_of_the_world_and_its_trial_are_named():
    trials = [msgspec.structs.replace(trial, scene_clearance_m=trial.map_clearance_m + 0.1) for trial in SAFE]
    numbers = {number.key: number for number in brief(Material("t", (run_of(trials),))).subjects[0].numbers}
    closest = numbers["min_clearance_m"]
    assert closest.value == pytest.approx(0.3)
    assert (closest.shown, closest.detail) == ("30 cm", "to the hulls, trial 2; 40 cm to the splats")
    assert len(numbers) == 4


def test_a_map_is_covered_only_by_a_certificate():
    assert said(cover=COVER)[0].startswith("This map was not checked")
    proven = {
        "covered": True,
        "checks": [{"name": "every ellipsoid lies in the voxels"}],
        "level": {"sigma": 2.0},
        "omits": [],
    }
    found = brief(Material("t", cover=COVER, certificate=proven))
    assert (found.verdict, found.tone) == ("The map covers the scan: checked again, and proven.", "good")
    assert (
        "Proven: every Gaussian of the scan up to 2 standard deviations lies inside the map." in found.proofs
    )
    found = brief(Material("t", cover=COVER, certificate=proven | {"covered": False}))
    assert (found.tone, found.proofs) == ("bad", ())
    assert "The map leaves out obstacles that the scan shows." in found.limits


def test_a_plan_is_clear_only_by_its_proof():
    assert said(plan=make_plan())[1] == "plain"
    plan = make_plan()
    proven = msgspec.structs.replace(plan.manifest, certificate={"min_proven_clearance_m": 0.25})
    too_near = msgspec.structs.replace(plan.manifest, certificate={"min_proven_clearance_m": 0.05})
    kind = type(plan)
    assert said(plan=kind(proven, plan.arrays)) == (
        "The plan keeps its centre 25 cm from everything in the map: proven.",
        "good",
    )
    assert said(plan=kind(too_near, plan.arrays))[1] == "bad"
    known = msgspec.structs.replace(proven, maps=[{"map": "scene", "level": {"sigma": 0.05}}])
    assert said(plan=kind(known, plan.arrays))[0] == (
        "The plan keeps its centre 25 cm from everything in the map, of Gaussians up to 0.05 standard "
        "deviations: proven."
    )


def test_a_proof_is_stated_only_where_the_run_claims_it():
    proven = {"proven_by_filter": True, "continuous_time": True}
    found = brief(Material("t", (run_of(SAFE, claims=proven),)))
    assert [line.split(":")[0] for line in found.proofs] == ["Proven beforehand", "Checked after the flights"]
    found = brief(Material("t", (run_of(SAFE, claims={}),)))
    assert found.proofs == ()
    assert "No proof beforehand says that polytope-cbf keeps these flights clear." in found.limits
    found = brief(Material("t", (run_of([*SAFE, HIT], claims=proven),)))
    assert not any("Proven" in line for line in found.proofs)
    assert "The proofs of a do not cover what its flights touched: see its statement below." in found.limits


def test_a_chain_is_stated_as_it_holds():
    whole = {"chain": {"holds": True, "broken_by": []}}
    assert any("met nothing of the scan" in line for line in brief_of(SAFE, whole).proofs)
    assert not any("met nothing" in line for line in brief_of([*SAFE, HIT], whole).proofs)
    broken = brief_of(SAFE, {"chain": {"holds": False, "broken_by": ["The cover was made elsewhere."]}})
    assert "Nothing is proven of a and the scan: The cover was made elsewhere." in broken.limits
    assert not any("met nothing" in line for line in broken.proofs)


def brief_of(trials, claims):
    return brief(Material("t", (run_of(trials, claims=claims),)))


@pytest.mark.parametrize("how", ["cover", "certificate", "scene"])
def test_a_run_in_another_map_than_that_of_the_report_is_named(how):
    """The map that is shown, the map that is proven, or the scan is not the one that was flown in."""
    role = "scene" if how == "scene" else "cover"
    ours, theirs = (InputRef(role, "", "", digit * 64, "a.npz") for digit in "12")
    run = run_of(SAFE)
    record = msgspec.structs.replace(
        run.record, provenance=msgspec.structs.replace(run.record.provenance, inputs=[ours])
    )
    for shown, is_named in ((theirs, True), (ours, False)):
        others = {"certified_cover": shown.sha256} if how == "certificate" else {"inputs": (shown,)}
        found = brief(Material("t", (Run("a", record),), **others))
        assert ("Not flown in the map and scan of this report: a." in found.verdict) == is_named
        assert any("a flew in another" in line for line in found.limits) == is_named
