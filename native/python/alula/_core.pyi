"""Hot loops of alula, in C++20 and C99."""

from collections.abc import Sequence
import enum
from typing import Annotated, Any

import numpy
from numpy.typing import NDArray


def commit() -> str:
    """The commit that a wheel was built from; empty in an editable build."""

MAX_VOXELS: int = 134217728

def voxelize(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat_wxyz: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], sigma: float, voxel_size: float, inflation: float = 0.0, crop: Sequence[float] | None = None, tile: tuple[Sequence[int], Sequence[int]] | None = None, min_overlap: int = 1, jobs: int = 0, progress: object | None = None, loss: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None) -> tuple[NDArray[numpy.int32], NDArray[numpy.uint32], NDArray[numpy.uint8], int, int]:
    """
    Voxels that ellipsoids touch: (index i32 (M, 3) sorted, overlap u32 (M,), reach u8 (N,): 0 where an
    ellipsoid marks nothing, 2 where its box exceeds the crop, else 1; voxels that fewer than min_overlap
    touch, which are left out; the highest overlap). Voxel i is the closed cube [i g, (i + 1) g];
    ellipsoids are at level sigma, grown by a ball of radius inflation (outer bounds) and by what `loss`
    (N, 3) says of each: error of the centre, of semi-axes relatively, of the rotation; all lengths in the
    unit of mean. Every touched voxel is marked; a voxel farther than 3e-13 of the coordinates' size is
    not. With a tile (lowest index, highest index) only its voxels. Raises ValueError for malformed input,
    OverflowError when the voxels exceed the memory budget.
    """

def tiles_of(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat_wxyz: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], sigma: float, voxel_size: float, inflation: float, crop: Sequence[float] | None, edge: int, progress: object | None = None, loss: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None) -> tuple[NDArray[numpy.int32], NDArray[numpy.int64], NDArray[numpy.uint32]]:
    """
    Tiles of edge^3 voxels that ellipsoids may touch, by their boxes: (tile i32 (T, 3) sorted, start i64
    (T + 1), row u32): tile t holds the voxels t edge ... t edge + edge - 1. Raises OverflowError for more
    than 2^20 tiles or 2^27 rows.
    """

def joined_voxels(index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], count: Annotated[NDArray[numpy.uint32], dict(shape=(None,), order='C', device='cpu', writable=False)], start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> tuple[NDArray[numpy.int32], NDArray[numpy.uint32]]:
    """
    One sorted list (index, count) of disjoint sorted lists of voxels: rows start[i] ... start[i + 1] - 1.
    """

def unproven_voxels(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat_wxyz: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], sigma: float, voxel_size: float, inflation: float, crop: Sequence[float] | None, min_overlap: int, index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], jobs: int = 0, progress: object | None = None, loss: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None) -> tuple[int, NDArray[numpy.int32], NDArray[numpy.int64]]:
    """
    Voxels outside `index` (M, 3) that are not proven to be touched by fewer than min_overlap ellipsoids:
    (total, the first 100 of them i32 (K, 3) in lexicographic order, an ellipsoid that touches each i64 (K,)).
    Voxel i is the closed cube [i g, (i + 1) g]; ellipsoids are at level sigma plus a ball of radius inflation
    and what `loss` says of each, voxels those that touch the crop. Every voxel not reported is proven by a separating plane with rigorous
    rounding bounds. Raises ValueError for malformed input, OverflowError when the memory budget is exceeded.
    """

class MergeJournal:
    """
    The volumes that a merge has measured. Given to the same merge again, it takes them from
    here and so comes to the same result sooner; for another merge it starts anew.
    """

    def __init__(self, data: bytes = ...) -> None:
        """From an earlier snapshot; ValueError when it is damaged."""

    def snapshot(self) -> bytes:
        """All entries so far; may be called from any thread while merging."""

    def __len__(self) -> int: ...

    @property
    def reused(self) -> int:
        """How many measurements were taken from here since it was made."""

def lattice_hull(points: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> dict[str, Any]:
    """
    Exact hull of integer points (N, 3): sorted vertices and primitive planes, as a cover of one hull.
    """

def cover_excess(voxels: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_normal: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], plane_offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], jobs: int, progress: object | None) -> float:
    """
    Volume [voxels] of the union of polytopes outside sorted voxels (M, 3), all of which they contain.
    """

def merge_cover(voxels: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], member: Annotated[NDArray[numpy.uint32], dict(shape=(None,), order='C', device='cpu', writable=False)], member_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], block: int, is_paper: bool, max_hulls: int, max_planes: int, max_bytes: int, facet_cap: int, kdop: int, is_fitted: bool, max_growth: float, jobs: int, journal: MergeJournal | None, progress: object | None) -> dict[str, Any]:
    """
    Cover sorted voxels (M, 3) by merged hulls. `member` holds voxel numbers of the start sets, or an
    empty `member_start` asks for the set cover by clusters. A limit of 0 is none. `facet_cap` and `kdop`
    ask for outer polytopes; `is_fitted` for as many hulls as make the least of the budget. Returns the
    arrays of an alula/cover, the curve (hulls, sum of W, planes, bytes), what was measured (hulls, planes,
    bytes, excess [voxels]), the excess of the union [voxels] and its grid.
    """

def union_measure(normal: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offset: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], lower: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], upper: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], voxels: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], sliver: float, jobs: int, progress: object | None) -> dict[str, Any]:
    """
    Volume of the union of polytopes {normal . x <= offset} with unit normals (F, 3), row-compressed by
    `start` (n + 1,), each within its box, in voxel edges; its intersection with sorted voxels (M, 3), how many
    of them lack no more than `sliver` of their volume, and a bound on the rounding error of both volumes.
    """

def check_cover_hulls(vertex: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_normal: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], plane_offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], member_index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], member_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], is_outer: bool, jobs: int, progress: object | None) -> NDArray[numpy.int64]:
    """
    Exact check of each hull of a cover. Returns rows (fault, hull, row, other), ordered by hull.
    """

def check_cover_occupied(member_index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], member_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], occupied: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.int64]:
    """
    Whether the members of a cover are exactly the occupied voxels. Returns rows as check_cover_hulls.
    """

def cover_fault(fault: int) -> str:
    """What a fault number of the checks above means."""

class PolytopeCbf:
    """
    The onboard safety filter among convex polytopes {x : normal . x <= offset}.

    Normals are outward unit vectors (F, 3), offsets in metres, world frame; extent_m bounds
    the coordinates of all positions. Raises ValueError for what the filter does not accept.
    """

    def __init__(self, normal: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offset: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], *, extent_m: float, radius_m: float, beta: float = 2.0, kappa: float = 100.0, dt_s: float = 0.01, v_max: float = 1.0, smoothing: str = 'sound', brute_force: bool = False) -> None: ...

    def filter(self, x: Sequence[float], u_nom: Sequence[float]) -> tuple[list[float], int, float, float, int]:
        """
        (u, status, margin of the smooth psi, margin of the hard psi, nearest hull or -1); margins in metres.
        """

    def psi(self, points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], *, jobs: int = 0) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64], NDArray[numpy.float64]]:
        """
        Smooth psi (N), hard psi (N) and the gradient of the smooth one (N, 3) at points (N, 3) [m].
        """

    def map_arrays(self) -> tuple[NDArray[numpy.float32], NDArray[numpy.uint32], NDArray[numpy.float32], NDArray[numpy.float32], float, float]:
        """
        The single-precision map: plane (F, 4), plane_start (n + 1), lower and upper (n, 3), extent and slack [m].
        """

def onboard_exp_log(x: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> tuple[NDArray[numpy.float32], NDArray[numpy.float32]]:
    """
    The onboard exponential and logarithm, for checking their error bounds.
    """

def encode_map_records(vertex: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_normal: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin: tuple[int, int, int], largest_normal: int, jobs: int, progress: object | None) -> tuple[bytes, int, bool, int, int]:
    """
    Hulls of a cover as records of an onboard map: (bytes, oblique planes, whether their normals are of the
    k-DOP family, largest normal, largest shift). Raises ValueError, and OverflowError beyond 16 bits.
    """

def check_map_voxels(lower: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], upper: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], normal: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], voxel: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], jobs: int, progress: object | None) -> NDArray[numpy.int64]:
    """Rows of voxels (M, 3) that no hull of a decoded map contains, exactly."""

def check_map_polytopes(lower: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], upper: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], normal: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], vertex: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> NDArray[numpy.int64]:
    """
    Polytopes, given by their vertices, that no hull of a decoded map with the same box contains, exactly.
    """

class OnboardMap:
    """
    An image of an onboard map, read by the C code that runs on a microcontroller.

    Raises ValueError with the reader's complaint for an image that it refuses.
    """

    def __init__(self, image: bytes) -> None: ...

    @property
    def hulls(self) -> int: ...

    @property
    def planes(self) -> int: ...

    @property
    def margin_m(self) -> float: ...

    @property
    def extent_m(self) -> float: ...

    def records(self) -> tuple[NDArray[numpy.int32], NDArray[numpy.int32], NDArray[numpy.uint32], NDArray[numpy.int32], NDArray[numpy.uint32]]:
        """
        lower and upper (n, 3), oblique planes per hull (n), their normals (K, 3) and depths (K).
        """

    def psi(self, points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], *, jobs: int = 0) -> tuple[NDArray[numpy.float32], NDArray[numpy.uint32], NDArray[numpy.float32]]:
        """psi (N) [m], nearest hull (N) and normal (N, 3) at points (N, 3) [m]."""

class TrialRules:
    """When a flight ends, and its nominal controller."""

    def __init__(self, *, dt_s: float, gain: float, v_max: float, stop_fraction: float, stuck_speed: float, stuck_steps: int, max_steps: int) -> None: ...

class Trial:
    """
    One flight a step at a time: nominal(), then advance() with the input that is flown.
    The reference arrays (K, 3) hold a row every dt; without rows the goal is flown to.
    """

    def __init__(self, start: Sequence[float], goal: Sequence[float], rules: TrialRules, reference_position: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], reference_velocity: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> None: ...

    def nominal(self) -> list[float]: ...

    def advance(self, u: Sequence[float], refused: bool) -> int:
        """
        The outcome after the step: 0 flying, 1 reached, 2 stuck, 3 timeout, 4 refused.
        """

    @property
    def position(self) -> list[float]: ...

def rollout(cbf: PolytopeCbf, start: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], goal: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], rules: TrialRules, reference_position: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], reference_velocity: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], *, use_filter: bool, jobs: int = 0, progress: object | None = None) -> list[dict[str, Any]]:
    """
    Fly all trials on threads; per trial a dict of position (steps + 1, 3), u_nom and u (steps, 3), margin, status and filter_s (steps), and the outcome.
    """

class PolytopeSet:
    """Convex polytopes in a bounding-volume hierarchy."""

    def __init__(self, normals: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offsets: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], vertices: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None:
        """
        Copy the polytopes {x : normal . x <= offset}, unit normals, with their vertices.
        """

    def __len__(self) -> int: ...

    def bounds(self) -> tuple[list[float], list[float]]:
        """
        Lower and upper corner of the box around all polytopes; zeros when there are none.
        """

    def clearance(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], end: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], cap: float, jobs: int = 0, progress: object | None = None) -> NDArray[numpy.float64]:
        """
        Signed distance of each segment start[i]..end[i] to the nearest obstacle, at most `cap`; negative inside.
        """

class EllipsoidSet:
    """Ellipsoids of Gaussians in a bounding-volume hierarchy."""

    def __init__(self, mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat_wxyz: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], k: float, loss: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None) -> None:
        """
        Copy the Gaussians; the ellipsoids are at level k, each grown by what `loss` (N, 3) says.
        """

    def __len__(self) -> int: ...

    def clearance(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], end: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], cap: float, jobs: int = 0, progress: object | None = None) -> NDArray[numpy.float64]:
        """
        Signed distance of each segment start[i]..end[i] to the nearest obstacle, at most `cap`; negative inside.
        """

class SearchStatus(enum.Enum):
    """Outcome of `find_path`."""

    found = 0

    no_path = 1

    start_isolated = 2

    goal_isolated = 3

MAX_LATTICE_POINTS: int = 33554432

def find_path(obstacles: PolytopeSet, origin: Sequence[float], spacing: float, count: Sequence[int], start: Sequence[float], goal: Sequence[float], radius: float, comfort: float, progress: object | None = None) -> tuple[SearchStatus, NDArray[numpy.float64], int]:
    """
    Lattice path of a ball among polytopes: status, points (W, 3), lattice points expanded.
    """

def tighten_path(obstacles: PolytopeSet, path: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], radius: float, comfort: float, spacing: float, rounds: int, jobs: int = 0, progress: object | None = None) -> NDArray[numpy.float64]:
    """Shortcut a free path along proven straight segments."""

def check_curves(obstacles: PolytopeSet, control_points: Annotated[NDArray[numpy.float64], dict(shape=(None, 8, 3), order='C', device='cpu', writable=False)], slack: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], radius: float, max_depth: int, jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.uint8], NDArray[numpy.float64], int, int]:
    """
    Prove that curves, shape (P, 8, 3) in Bernstein form, keep `radius` from all polytopes: per piece proven (u8) and clearance, then the pairs decided and the deepest subdivision.
    """

def outer_solids(normal: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], jobs: int) -> dict[str, Any]:
    """
    Corners and outward triangles of the polytopes normal . x <= offset, found exactly, rounded in the end.
    """

def decode_ply_rows(rows: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], row_size: int, big_endian: bool, places: Sequence[tuple[int, str] | None], color: str, mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')], quat: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu')], opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu')], out_color: Annotated[NDArray[numpy.uint8], dict(shape=(None, 3), order='C', device='cpu')], jobs: int = 0, progress: object | None = None) -> None:
    """
    Decode binary rows of Gaussians into the given arrays, as many as these have rows. `places` has for x, y,
    z, scale_0..2, rot_0..3, opacity and three columns of colour (offset in the row, NumPy's code of the type),
    or None without scale_2 or colour; `color` is harmonic, bytes or grey. The same bits on every machine.
    """

def find_lines(text: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], most: int) -> tuple[NDArray[numpy.uint64], int]:
    """
    Where the first `most` lines that are not blank start, and the bytes of all further ones.
    """

def decode_ply_text(text: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], start: Annotated[NDArray[numpy.uint64], dict(shape=(None,), order='C', device='cpu', writable=False)], width: int, places: Sequence[tuple[int, str] | None], color: str, mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')], quat: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu')], opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu')], out_color: Annotated[NDArray[numpy.uint8], dict(shape=(None, 3), order='C', device='cpu')], jobs: int = 0, progress: object | None = None) -> tuple[int, int, int, int] | None:
    """
    As decode_ply_rows for lines of `width` numbers that start at `start`; places count words. None, or what
    is wrong first: (row, its words, begin and end of a word that is no number if it has `width` of them).
    """

def portable_exp(x: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """
    exp of each to less than 1.3 units in the last place, the same bits on every machine. Arguments beyond
    +-200 count as +-200, which is infinity and zero in single precision; NaN stays NaN.
    """

def portable_logistic(x: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """1 / (1 + exp(-x)) of each, by portable_exp."""

def screen_rows(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], removal: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu')], *, min_opacity: float, crop: Sequence[float] | None = None, crop_sphere: Sequence[float] | None = None, max_scale: float | None = None, jobs: int = 0) -> tuple[list[int], int]:
    """
    Write into `removal` (N,) why each row is left out, 0 for kept; see alula/scene_rows.hpp for the order of
    the reasons. Returns how many rows have each, and the first row that is not finite, N if there is none.
    """

def keep_rows(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], color: Annotated[NDArray[numpy.uint8], dict(shape=(None, 3), order='C', device='cpu', writable=False)], removal: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], *, scale_floor: float, out_mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')] | None = None, out_scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')] | None = None, out_quat: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu')] | None = None, out_opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu')] | None = None, out_color: Annotated[NDArray[numpy.uint8], dict(shape=(None, 3), order='C', device='cpu')] | None = None, jobs: int = 0) -> dict[str, Any]:
    """
    Copy the rows whose removal is 0 to the outputs that are given, quaternions normalised and semi-axes no
    smaller than the floor. Returns lower, upper, scale_max, scale_median (of the longest semi-axes),
    opacity_median and floored (rows with a semi-axis below the floor) of these.
    """
