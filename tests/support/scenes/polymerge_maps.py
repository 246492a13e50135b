"""Maps of two small scenes, as the comparison with PolyMerge takes them."""

from papers.polymerge.maps import Polytopes, SceneMaps
from papers.polymerge.measure import Measure

OURS = Polytopes(30, 400, 1.2, 50_000, Measure(1000, 1200.0, 1000.0, 0, 1e-9), 1600)
RULE = Polytopes(30, 420, 1.25, 51_000, Measure(1000, 1250.0, 1000.0, 0, 1e-9))
COACD = Polytopes(30, 500, 1.3, 90_000, Measure(1000, 1300.0, 875.0, 250, 1e-9))
CURVE = [Polytopes(n, 14 * n, 1 + 6 / n) for n in (10, 30, 100)]
ROOM = SceneMaps(
    "room",
    20_000,
    900_000,
    1000,
    0.05,
    {"default": OURS, "paper": RULE, "coacd": COACD},
    {"default": CURVE, "paper": CURVE[1:]},
)
TREE = SceneMaps("tree <&>", 10, 1000, 8, 0.5, {"default": OURS, "paper": RULE}, {"default": CURVE})
