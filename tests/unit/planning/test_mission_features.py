"""Random missions over all features are planned, and what is planned is proven and flies the mission."""

from collections import Counter

import pytest

from alula.schemas.errors import AlulaError
from support.attack.missions import disagreements, features

CASES = range(18)


@pytest.mark.slow
def test_what_is_planned_of_any_mission_is_proven_and_judged_to_fly_it():
    seen = Counter()
    for seed in CASES:
        try:
            wrong, made = disagreements(seed)
        except AlulaError:
            continue
        assert wrong == [], f"case({seed})"
        seen.update(name for name, has in features(made).items() if has)
    assert min(seen[name] for name in ("gates", "rests", "tolerances", "laps", "turns", "moved ends")) >= 2
