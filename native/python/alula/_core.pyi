"""Hot loops of alula, in C++20 and C99."""

from collections.abc import Mapping, Sequence
import enum
from typing import Annotated, Any, overload

import numpy
import numpy.typing
from numpy.typing import NDArray


def commit() -> str:
    """The commit that a wheel was built from; empty in an editable build."""

MAX_VOXELS: int = 134217728

def voxelize(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat_wxyz: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], sigma: float, voxel_size: float, inflation: float = 0.0, crop: Sequence[float] | None = None, tile: tuple[Sequence[int], Sequence[int]] | None = None, min_overlap: int = 1, jobs: int = 0, progress: object | None = None, loss: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None) -> tuple[NDArray[numpy.int32], NDArray[numpy.uint32], NDArray[numpy.uint8], int, int]:
    """
    Find the voxels that ellipsoids touch: (index i32 (M, 3) sorted, overlap u32 (M,), reach u8 (N,): 0 where an
    ellipsoid marks nothing, 2 where its box exceeds the crop, else 1; voxels that fewer than min_overlap
    touch, which are left out; the highest overlap). Voxel i is the closed cube [i g, (i + 1) g];
    ellipsoids are at level sigma, grown by a ball of radius inflation (outer bounds) and by `loss`
    (N, 3) of each: error of the centre, relative error of the semi-axes, error of the rotation; all lengths in the
    unit of mean. Every touched voxel is marked; a voxel farther than 3e-13 of the coordinates' size is
    not. With a tile (lowest index, highest index) only its voxels. Raises ValueError for malformed input,
    OverflowError when the voxels exceed the memory budget.
    """

def tally_opacity(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat_wxyz: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], limits: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], origin: Sequence[float], edge: float, size: Sequence[int], jobs: int = 0) -> tuple[list[int], list[int]]:
    """
    Tally what one-sigma ellipsoids mark by their opacity, for ascending limits (L,): two lists of L + 1 counts, of
    the rows by rank, the number of limits not above their opacity, and of the cells by the highest rank of the
    rows that touch them. Cells have the edge `edge` and the indices 0 ... size - 1 from `origin`. Rows that are
    not finite do not count. Raises ValueError for malformed input.
    """

def tiles_of(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat_wxyz: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], sigma: float, voxel_size: float, inflation: float, crop: Sequence[float] | None, edge: int, progress: object | None = None, loss: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None) -> tuple[NDArray[numpy.int32], NDArray[numpy.int64], NDArray[numpy.uint32]]:
    """
    Find the tiles of edge^3 voxels that ellipsoids may touch, by their boxes: (tile i32 (T, 3) sorted, start i64
    (T + 1), row u32): tile t holds the voxels t edge ... t edge + edge - 1. Raises OverflowError for more
    than 2^20 tiles or 2^27 rows.
    """

def joined_voxels(index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], count: Annotated[NDArray[numpy.uint32], dict(shape=(None,), order='C', device='cpu', writable=False)], start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> tuple[NDArray[numpy.int32], NDArray[numpy.uint32]]:
    """
    Merge disjoint sorted lists of voxels into one sorted list (index, count): rows start[i] ... start[i + 1] - 1.
    """

def touched_by_triangles(corners: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], radius: float, voxel_size: float, crop: Sequence[float] | None = None, min_count: int = 1, jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.int32], NDArray[numpy.uint32], int, int]:
    """
    Find the voxels that triangles (T, 3, 3), each plus a ball, touch: (index i32 (M, 3) sorted, number of
    triangles u32 (M,), voxels that fewer than min_count touch and that are left out, the highest number).
    Voxel i is the closed cube [i g, (i + 1) g]. Every touched voxel is marked; one that is farther than the
    radius by 1e-13 of the coordinates' size is not. Raises ValueError for malformed input, OverflowError when
    the voxels exceed the memory budget.
    """

def touched_by_points(points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], radius: float, voxel_size: float, crop: Sequence[float] | None = None, min_count: int = 1, jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.int32], NDArray[numpy.uint32], int, int]:
    """
    Find the voxels that balls around points (N, 3) touch, as `touched_by_triangles`.
    """

def voxels_of_blocks(lower: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], upper: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], voxel_size: float, crop: Sequence[float] | None = None, jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.int32], NDArray[numpy.uint32], int, int]:
    """
    List the voxels of blocks lower ... upper, inclusive, as `touched_by_triangles`.
    """

def with_inside(index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], count: Annotated[NDArray[numpy.uint32], dict(shape=(None,), order='C', device='cpu', writable=False)], corners: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], voxel_size: float, crop: Sequence[float] | None = None, jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.int32], NDArray[numpy.uint32], int, int]:
    """
    Add to the voxels that a closed oriented surface touches all that it encloses, with a count of 0, and keep
    those that touch the crop; as `touched_by_triangles`. Raises ValueError if the surface is not closed.
    """

def unproven_triangles(corners: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], radius: float, voxel_size: float, crop: Sequence[float] | None, min_count: int, index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], jobs: int = 0, progress: object | None = None) -> tuple[int, NDArray[numpy.int32], NDArray[numpy.int64]]:
    """
    Prove by planes that voxels outside of `index` are touched by fewer than min_count triangles, each plus a
    ball: (number without a proof, the first of them i32 (K, 3), the first triangle of each i64 (K,)).
    """

def unproven_outside(corners: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], voxel_size: float, crop: Sequence[float] | None, index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], jobs: int = 0, progress: object | None = None) -> tuple[int, NDArray[numpy.int32], NDArray[numpy.int64]]:
    """
    Prove by rays that voxels outside of `index`, none of which a closed oriented surface touches, lie outside
    of it; as `unproven_triangles`, with -1 for the triangle.
    """

def octree_leaves(body: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], is_binary: bool, payload: int = 0) -> tuple[NDArray[numpy.int32], NDArray[numpy.int32], NDArray[numpy.uint8], int]:
    """
    Read the nodes of OctoMap's trees: cubes (lower i32 (N, 3) from -2^15, edge i32 (N,), state u8 (N,): 0
    unknown, 1 free, 2 occupied; number of nodes). Raises ValueError if the bytes are no tree.
    """

class Occluders:
    """
    Ellipsoids at level sigma, grown by a ball of radius inflation (outer bounds) and by
    `loss` (N, 3) of each, prepared for the depth images of many cameras.
    """

    def __init__(self, mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat_wxyz: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], sigma: float, inflation: float = 0.0, worth: float = 0.01, jobs: int = 0, progress: object | None = None, loss: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None) -> None:
        """
        An ellipsoid whose bound exceeds its sum with the ball by more than `worth` gets a second bound.
        """

    def depth(self, rotation: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], centre: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], image: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)], pixels: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], near: float, range: float) -> tuple[NDArray[numpy.float32], bool]:
        """
        Depth image of one camera, given as by `observe`: (1 / z f32 (rows, columns), an upper bound for every
        surface in the pixel's pyramid, 1 / range without one; whether an ellipsoid touches the camera).
        """

def observe(occluders: Occluders, rotation: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], centre: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], image: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)], pixels: Annotated[NDArray[numpy.int64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], near: float, range: float, voxel_size: float, lower: Sequence[int], blocked: Annotated[NDArray[numpy.uint8], dict(shape=(None, None, None), order='C', device='cpu', writable=False)], margin: float = 0.0, jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.uint16], NDArray[numpy.uint64], NDArray[numpy.uint8]]:
    """
    Count the cameras that see each voxel of a box wholly: (u16 like `blocked`; u64 (K,): voxels that each camera
    sees; u8 (K,): 1 where an ellipsoid touches the camera, which then sees nothing). Cameras are pinholes: x =
    rotation (world - centre), x right, y down, z forward; `image` (K, 4) has the smallest x/z and y/z and the
    largest x/z and y/z, `pixels` (K, 2) the columns and rows. Voxels in `blocked`, u8 (X, Y, Z) from voxel
    `lower`, are never seen, and hide what lies behind them. `margin` grows voxels at the image's border and at
    the depth `near`. The result does not depend on `jobs`.
    """

def unproven_voxels(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat_wxyz: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], sigma: float, voxel_size: float, inflation: float, crop: Sequence[float] | None, min_overlap: int, index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], jobs: int = 0, progress: object | None = None, loss: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None) -> tuple[int, NDArray[numpy.int32], NDArray[numpy.int64]]:
    """
    Voxels outside `index` (M, 3) that are not proven to be touched by fewer than min_overlap ellipsoids:
    (total, the first 100 of them i32 (K, 3) in lexicographic order, an ellipsoid that touches each i64 (K,)).
    Voxel i is the closed cube [i g, (i + 1) g]; ellipsoids are at level sigma plus a ball of radius inflation
    and grown by `loss` of each; only voxels that touch the crop count. Every voxel not reported is proven by a separating plane with rigorous
    rounding bounds. Raises ValueError for malformed input, OverflowError when the memory budget is exceeded.
    """

class MergeJournal:
    """
    Log of the volumes that a merge has measured. The same merge run again reads them from
    the journal and finishes sooner with the same result; another merge discards them.
    """

    def __init__(self, data: bytes = ...) -> None:
        """Restore an earlier snapshot; ValueError when it is damaged."""

    def snapshot(self) -> bytes:
        """All entries so far; may be called from any thread while merging."""

    def __len__(self) -> int: ...

    @property
    def reused(self) -> int:
        """Number of measurements read from the journal since it was created."""

def lattice_hull(points: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> dict[str, Any]:
    """
    Exact hull of integer points (N, 3): sorted vertices and primitive planes, as a cover of one hull.
    """

def cover_excess(voxels: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_normal: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], plane_offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], jobs: int, progress: object | None) -> float:
    """
    Volume [voxels] of the union of polytopes outside sorted voxels (M, 3); the union contains every voxel.
    """

def merge_cover(voxels: NDArray[numpy.int32], member: NDArray[numpy.uint32], member_start: NDArray[numpy.int64], *, block: int, is_paper: bool, max_hulls: int, max_planes: int, max_bytes: int, facet_cap: int, kdop: int, is_fitted: bool, is_final: bool, max_growth: float, jobs: int, journal: MergeJournal | None, progress: object | None) -> dict[str, Any]:
    """
    Cover sorted voxels (M, 3) by merged hulls. `member` holds voxel numbers of the start sets; with an
    empty `member_start` the set cover by clusters is computed. A limit of 0 means no limit. `facet_cap` and `kdop`
    give outer polytopes; with `is_fitted` the number of hulls minimises the excess within the budget.
    Returns the arrays of an alula/cover, the curve (hulls, sum of W, planes, bytes), the measurements
    (hulls, planes, bytes, excess [voxels]), the excess of the union [voxels] and its grid.
    """

def union_measure(normal: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offset: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], lower: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], upper: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], voxels: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], sliver: float, jobs: int, progress: object | None) -> dict[str, Any]:
    """
    Volume of the union of polytopes {normal . x <= offset} with unit normals (F, 3), row-compressed by
    `start` (n + 1,), each within its box, in voxel edges; its intersection with sorted voxels (M, 3), how many
    of them lack no more than `sliver` of their volume, and a bound on the rounding error of both volumes.
    """

def check_cover_hulls(vertex: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_normal: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], plane_offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], member_index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], member_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], is_outer: bool, jobs: int, progress: object | None) -> NDArray[numpy.int64]:
    """
    Check each hull of a cover exactly. Returns rows (fault, hull, row, other), ordered by hull.
    """

def check_cover_occupied(member_index: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], member_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], occupied: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.int64]:
    """
    Check that the members of a cover are exactly the occupied voxels. Returns rows as check_cover_hulls.
    """

def cover_fault(fault: int) -> str:
    """Meaning of a fault number of the checks above."""

class PolytopeCbfConfig:
    """Parameters of the onboard safety filter among polytopes."""

    def __init__(self, *, radius_m: float = 0.0, beta: float = 2.0, kappa: float = 100.0, dt_s: float = 0.01, v_max: float = 1.0, smoothing: str = 'sound', brute_force: bool = False) -> None:
        """
        Args:
            radius_m: radius r of the vehicle's sphere [m]
            beta: gain of the barrier, at most 1 / dt [1/s]
            kappa: sharpness of the smoothing; with speed * dt * kappa above 1 many steps are cut short [1/m]
            dt_s: how long a command is held [s]
            v_max: speed limit of the command [m/s]
            smoothing: smoothing of the distance
            brute_force: evaluate every plane; the results are the same, bit by bit
        """

    @property
    def radius_m(self) -> float:
        """radius r of the vehicle's sphere [m]"""

    @property
    def beta(self) -> float:
        """gain of the barrier, at most 1 / dt [1/s]"""

    @property
    def kappa(self) -> float:
        """
        sharpness of the smoothing; with speed * dt * kappa above 1 many steps are cut short [1/m]
        """

    @property
    def dt_s(self) -> float:
        """how long a command is held [s]"""

    @property
    def v_max(self) -> float:
        """speed limit of the command [m/s]"""

    @property
    def smoothing(self) -> str:
        """smoothing of the distance"""

    @property
    def brute_force(self) -> bool:
        """evaluate every plane; the results are the same, bit by bit"""

class PolytopeCbf:
    """
    The onboard safety filter among convex polytopes {x : normal . x <= offset}.

    Normals are outward unit vectors (F, 3), offsets in metres, world frame; extent_m bounds
    the coordinates of all positions. Raises ValueError for arguments that the filter rejects.
    """

    def __init__(self, normal: NDArray[numpy.float64], offset: NDArray[numpy.float64], plane_start: NDArray[numpy.int64], *, extent_m: float, radius_m: float = 0.0, beta: float = 2.0, kappa: float = 100.0, dt_s: float = 0.01, v_max: float = 1.0, smoothing: str = 'sound', brute_force: bool = False) -> None:
        """
        Args:
            extent_m: bound of the coordinates of all positions [m]
            radius_m: radius r of the vehicle's sphere [m]
            beta: gain of the barrier, at most 1 / dt [1/s]
            kappa: sharpness of the smoothing; with speed * dt * kappa above 1 many steps are cut short [1/m]
            dt_s: how long a command is held [s]
            v_max: speed limit of the command [m/s]
            smoothing: smoothing of the distance
            brute_force: evaluate every plane; the results are the same, bit by bit
        """

    @property
    def config(self) -> PolytopeCbfConfig: ...

    def filter(self, x: Sequence[float], u_nom: Sequence[float]) -> tuple[list[float], int, float, float, int]:
        """
        (u, status, margin of the smooth psi, margin of the hard psi, nearest hull or -1); margins in metres.
        """

    @staticmethod
    @staticmethod
    def from_image(image: bytes, *, extent_m: float, radius_m: float = 0.0, beta: float = 2.0, kappa: float = 100.0, dt_s: float = 0.01, v_max: float = 1.0, smoothing: str = 'sound', brute_force: bool = False) -> PolytopeCbf:
        """
        Create the filter from an image of an onboard map, as on a microcontroller. Raises ValueError with
        the reader's message for an image that it rejects.
        """

    @staticmethod
    @staticmethod
    def from_tiles(tiles: TileSet, load_calls: int, *, extent_m: float, radius_m: float = 0.0, beta: float = 2.0, kappa: float = 100.0, dt_s: float = 0.01, v_max: float = 1.0, smoothing: str = 'sound', brute_force: bool = False) -> PolytopeCbf:
        """
        Create the filter from tiles, of which two are resident: after the first, one that is needed comes
        `load_calls` calls later, and far from all resident ones commands are refused. Raises ValueError when the tiles do not
        reach far enough for the commands of the whole map.
        """

    def tile(self) -> tuple[int, bool]:
        """
        Row of the resident tile of the last call or -1, and whether it was in its region.
        """

    @property
    def reach_m(self) -> float:
        """Hulls with a larger psi cannot change a command [m]."""

    def reset(self) -> None:
        """Before another flight: no tile is resident."""

    def work(self) -> tuple[int, int, int, int, int]:
        """
        Counts of the last call of `filter`: boxes, hulls, planes of these hulls, planes that were
        decoded, exponentials of planes.
        """

    def psi(self, points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], *, jobs: int = 0) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64], NDArray[numpy.float64]]:
        """
        Smooth psi (N), hard psi (N) and the gradient of the smooth one (N, 3) at points (N, 3) [m].
        """

    def map_arrays(self) -> tuple[NDArray[numpy.float32], NDArray[numpy.uint32], NDArray[numpy.float32], NDArray[numpy.float32], float, float]:
        """
        The single-precision map: plane (F, 4), plane_start (n + 1), lower and upper (n, 3), extent and slack [m].
        """

class OnboardChord:
    """
    The onboard filter of a vehicle that follows velocities with a lag: alula_chord.h.
    """

    def __init__(self, image: bytes, config: PolytopeCbfConfig, lag_s: float, extent_m: float = 0.0) -> None: ...

    def filter(self, x: Sequence[float], v: Sequence[float], u_nom: Sequence[float], is_taking_off: bool = False) -> tuple[list[float], int, float, float]:
        """(u, status, least D_k - r, psi - r at x); margins in metres."""

    def work(self) -> list[int]:
        """
        Of the last call: boxes, hulls, values of planes, decoded planes, rows, those inside margins.
        """

def onboard_exp_log(x: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> tuple[NDArray[numpy.float32], NDArray[numpy.float32]]:
    """
    The onboard exponential and logarithm, for checking their error bounds.
    """

def encode_map_records(vertex: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_normal: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin: tuple[int, int, int], largest_normal: int, jobs: int, progress: object | None) -> tuple[bytes, int, bool, int, int]:
    """
    Encode the hulls of a cover as records of an onboard map: (bytes, oblique planes, whether the normals are of the
    k-DOP family, largest normal, largest shift). Raises ValueError, and OverflowError beyond 16 bits.
    """

def check_map_voxels(lower: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], upper: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], normal: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], voxel: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], jobs: int, progress: object | None) -> NDArray[numpy.int64]:
    """
    Find exactly the rows of voxels (M, 3) that no hull of a decoded map contains.
    """

def check_map_polytopes(lower: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], upper: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], normal: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], vertex: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], vertex_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> NDArray[numpy.int64]:
    """
    Find exactly the polytopes, given by vertices, that no hull of a decoded map with the same box contains.
    """

class TileSet:
    """
    A map in tiles: index and images, as the C code of a microcontroller reads them.

    With a key, the signature of the index must match. Raises ValueError with the reader's message.
    """

    def __init__(self, index: bytes, images: Sequence[bytes], *, key: bytes | None = None, signature: bytes = ...) -> None: ...

    def __len__(self) -> int: ...

    @property
    def reach_m(self) -> float: ...

class OnboardMap:
    """
    An image of an onboard map, read by the C code that runs on a microcontroller.

    Raises ValueError with the reader's message for an image that it rejects.
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

    def psi_along(self, points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> tuple[NDArray[numpy.float32], NDArray[numpy.uint32], NDArray[numpy.float32]]:
        """
        The same, with a search warm-started from the previous points: for points close to one another.
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
        Hold the arrays, which must not change; the ellipsoids are at level k, each grown by `loss` (N, 3).
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

def find_path(map: ObstacleMap, origin: Sequence[float], spacing: float, count: Sequence[int], start: Sequence[float], goal: Sequence[float], radius: float, comfort: float, progress: object | None = None) -> tuple[SearchStatus, NDArray[numpy.float64], int]:
    """
    Lattice path of a ball in an obstacle map: status, points (W, 3), lattice points expanded.
    """

def tighten_path(map: ObstacleMap, path: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], radius: float, comfort: float, spacing: float, rounds: int, progress: object | None = None) -> NDArray[numpy.float64]:
    """Shortcut a free path along proven straight segments."""

def widest_passage(map: ObstacleMap, lower: Sequence[float], upper: Sequence[float], start: Sequence[float], goal: Sequence[float], enough: float, tolerance: float, most_cells: int, progress: object | None = None) -> tuple[float, float, NDArray[numpy.float64], list[float], int]:
    """
    Bounds on the radius of a ball that passes within a box: (radius that passes along the returned path, radius above which none passes or `enough`, path (W, 3), its narrowest point, cells made).
    """

def nearest_free(map: ObstacleMap, lower: Sequence[float], upper: Sequence[float], point: Sequence[float], radius: float, tolerance: float, most_cells: int, progress: object | None = None) -> list[float] | None:
    """
    The point of a box with a distance of at least `radius` that is nearest to `point`, up to the tolerance; None if none was found.
    """

@overload
def check_curves(obstacles: PolytopeSet, control_points: Annotated[NDArray[numpy.float64], dict(shape=(None, 8, 3), order='C', device='cpu', writable=False)], slack: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], radius: float, max_depth: int, jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.uint8], NDArray[numpy.float64], int, int]: ...

@overload
def check_curves(obstacles: ObstacleMap, control_points: Annotated[NDArray[numpy.float64], dict(shape=(None, 8, 3), order='C', device='cpu', writable=False)], slack: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], radius: float, max_depth: int, jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.uint8], NDArray[numpy.float64], int, int]:
    """
    Prove that curves, shape (P, 8, 3) in Bernstein form, keep `radius` from all obstacles: per piece proven (u8) and clearance, then the pairs decided and the deepest subdivision.
    """

def corridor_cells(hulls: Sequence[PolytopeSet], ellipsoids: Sequence[EllipsoidSet], start: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], end: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], radius: float, reach: float, lower: Sequence[float], upper: Sequence[float], jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64], NDArray[numpy.int64], NDArray[numpy.uint8]]:
    """
    Convex cells around segments, every point of which keeps `radius` from all obstacles: normals (R, 3), offsets (R,), first rows (C + 1,), and whether each segment keeps the radius (u8).
    """

def check_cells(hulls: Sequence[PolytopeSet], ellipsoids: Sequence[EllipsoidSet], normals: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offsets: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], radius: float, jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.uint8], NDArray[numpy.float64], int]:
    """
    Prove that cells keep `radius` from all obstacles: per cell proven (u8) and clearance, then the pairs decided.
    """

class TimeStatus(enum.Enum):
    """Outcome of `minimum_time`."""

    solved = 0

    stopped_early = 1

    infeasible = 2

class MotionLimits:
    """Bounds of the derivatives of a curve at every instant, SI units."""

    def __init__(self, *, speed: float, acceleration: float, jerk: float = float('inf'), snap: float = float('inf'), gravity: float = 9.81, most_thrust: float = float('inf'), least_thrust: float = float('-inf'), tilt: float = float('inf')) -> None:
        """`tilt` is a tangent; thrusts are per mass."""

    @property
    def speed(self) -> float: ...

    @property
    def acceleration(self) -> float: ...

    @property
    def jerk(self) -> float: ...

    @property
    def snap(self) -> float: ...

    @property
    def gravity(self) -> float: ...

    @property
    def most_thrust(self) -> float: ...

    @property
    def least_thrust(self) -> float: ...

    @property
    def tilt(self) -> float: ...

def minimum_time(normals: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offsets: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], row_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], cell: Annotated[NDArray[numpy.uint32], dict(shape=(None,), order='C', device='cpu', writable=False)], limits: MotionLimits, start: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], goal: Sequence[float], joint: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], is_via: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], least_duration: float, gap: float, most_steps: int, stretch: float, centre: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None, normal: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None, opening: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None, speed: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None) -> tuple[TimeStatus, NDArray[numpy.float64], NDArray[numpy.float64], int]:
    """
    Fastest curve of degree 7 and class C4 in a corridor: status, Bernstein points (K, 8, 3), durations (K,), steps. `opening` (K - 1,) is the radius within which a via may be passed, about `centre` (K - 1, 3), or in the disc across `normal` (K - 1, 3) where that is not 0; `speed` (K,) limits single pieces.
    """

def outer_solids(normal: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offset: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], plane_start: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], jobs: int) -> dict[str, Any]:
    """
    Corners and outward triangles of the polytopes normal . x <= offset, computed exactly and rounded at the end.
    """

def decode_ply_rows(rows: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], row_size: int, big_endian: bool, places: Sequence[tuple[int, str] | None], color: str, mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')], quat: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu')], opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu')], out_color: Annotated[NDArray[numpy.uint8], dict(shape=(None, 3), order='C', device='cpu')], jobs: int = 0, progress: object | None = None) -> None:
    """
    Decode binary rows of Gaussians into the given arrays, as many as these have rows. `places` has for x, y,
    z, scale_0..2, rot_0..3, opacity and three columns of colour (offset in the row, NumPy's code of the type),
    or None without scale_2 or colour; `color` is harmonic, bytes or grey. The same bits on every machine.
    """

def find_lines(text: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], most: int) -> tuple[NDArray[numpy.uint64], int]:
    """
    Starts of the first `most` lines that are not blank, and the bytes of all further ones.
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
    Write into `removal` (N,) why each row is left out, 0 for kept; see alula/formats/scene_rows.hpp for the order of
    the reasons. Returns how many rows have each, and the first row that is not finite, N if there is none.
    """

def keep_rows(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], color: Annotated[NDArray[numpy.uint8], dict(shape=(None, 3), order='C', device='cpu', writable=False)], removal: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], *, scale_floor: float, out_mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')] | None = None, out_scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')] | None = None, out_quat: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu')] | None = None, out_opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu')] | None = None, out_color: Annotated[NDArray[numpy.uint8], dict(shape=(None, 3), order='C', device='cpu')] | None = None, jobs: int = 0) -> dict[str, Any]:
    """
    Copy the rows whose removal is 0 to the outputs that are given, quaternions normalised and semi-axes no
    smaller than the floor. Returns lower, upper, scale_max, scale_median (of the longest semi-axes),
    opacity_median and floored (rows with a semi-axis below the floor) of these.
    """

def map_rows(mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], *, factor: float, rotation: Sequence[Sequence[float]], translation: Sequence[float], quat_wxyz: Sequence[float], out_mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')], out_scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')], out_quat: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu')], out_moved: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu')] | None = None, jobs: int = 0) -> tuple[float, int, int]:
    """
    Write the rows mapped by x -> factor rotation x + translation, `quat_wxyz` being the rotation, rounded to
    single precision. `out_moved` (N,) gets bounds on how far rounding moves each centre. Returns the largest
    one and the first rows whose mean and scale do not fit, N if there is none.
    """

def rotation_of(sigma: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """
    R (N, 3, 3), from inertial to body components, of Modified Rodrigues Parameters (N, 3).
    """

def rate_matrix(sigma: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """Z (N, 3, 3) of sigma' = Z omega."""

def inverse_rate_matrix(sigma: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """The inverse of Z (N, 3, 3)."""

def rate_jacobian(sigma: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], omega: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """The derivative of Z omega by sigma (N, 3, 3)."""

def shadowed(sigma: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """The same attitudes with |sigma| <= 1."""

def turned(sigma: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], turn: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """
    The attitudes after turns by rotation vectors (N, 3) about the body's axes [rad].
    """

class Quadrotor:
    """
    A rigid body with four rotors that push along body z.

    States are rows (p, sigma, v, omega) of 12, wrenches rows (T, tau) of 4 [N, N m]; see native/core/include/alula/dynamics/quadrotor.hpp for frames and equations.
    """

    def __init__(self, *, mass: float, inertia: Sequence[float], rotor_x: Sequence[float], rotor_y: Sequence[float], spin: Sequence[float], torque_ratio: float, f_min: Sequence[float], f_max: Sequence[float], gravity: float = 9.81) -> None:
        """
        Args:
            mass: mass [kg]
            inertia: diagonal of the inertia [kg m^2]
            rotor_x: positions along body x [m]
            rotor_y: positions along body y [m]
            spin: sense of rotation, -1 or 1
            torque_ratio: drag torque per thrust [m]
            f_min: minimum thrust of each rotor [N]
            f_max: maximum thrust of each rotor [N]
            gravity: gravity [m/s^2]
        """

    @property
    def mass(self) -> float: ...

    @property
    def gravity(self) -> float: ...

    @property
    def inertia(self) -> list[float]: ...

    @property
    def f_min(self) -> list[float]: ...

    @property
    def f_max(self) -> list[float]: ...

    @property
    def hover_thrust(self) -> float: ...

    @property
    def max_thrust(self) -> float: ...

    @property
    def allocation(self) -> NDArray[numpy.float64]: ...

    @property
    def inverse_allocation(self) -> NDArray[numpy.float64]: ...

    def wrench(self, rotor_thrust: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """G f of rotor thrusts (N, 4)."""

    def rotor_thrust(self, u: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """Rotor thrusts (N, 4) of wrenches (N, 4)."""

    def admissible(self, u: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)], *, tolerance_n: float = 0.0) -> NDArray[numpy.uint8]:
        """1 where all rotors are within their limits."""

    def limited(self, u: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """
        Admissible wrenches: roll and pitch in preference to yaw, torque in preference to thrust.
        """

    def saturated(self, u: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """Wrenches after each rotor thrust is clipped to its limits."""

    def derivative(self, x: Annotated[NDArray[numpy.float64], dict(shape=(None, 12), order='C', device='cpu', writable=False)], u: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """x' (N, 12)."""

    def step(self, x: Annotated[NDArray[numpy.float64], dict(shape=(None, 12), order='C', device='cpu', writable=False)], u: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)], *, dt_s: float) -> NDArray[numpy.float64]:
        """States after one RK4 step with the wrenches held."""

class SensorOptions:
    """Noise (standard deviations per axis) and delay; all off by default."""

    def __init__(self, *, position_noise_m: float = 0.0, velocity_noise_m_s: float = 0.0, attitude_noise_rad: float = 0.0, rate_noise_rad_s: float = 0.0, noise_time_s: float = 0.0, delay_s: float = 0.0) -> None:
        """
        Args:
            position_noise_m: standard deviation per axis [m]
            velocity_noise_m_s: standard deviation per axis [m/s]
            attitude_noise_rad: standard deviation per axis [rad]
            rate_noise_rad_s: standard deviation per axis [rad/s]
            noise_time_s: correlation time of position and velocity; 0: white [s]
            delay_s: age of a measurement [s]
        """

    @property
    def position_noise_m(self) -> float:
        """standard deviation per axis [m]"""

    @property
    def velocity_noise_m_s(self) -> float:
        """standard deviation per axis [m/s]"""

    @property
    def attitude_noise_rad(self) -> float:
        """standard deviation per axis [rad]"""

    @property
    def rate_noise_rad_s(self) -> float:
        """standard deviation per axis [rad/s]"""

    @property
    def noise_time_s(self) -> float:
        """correlation time of position and velocity; 0: white [s]"""

    @property
    def delay_s(self) -> float:
        """age of a measurement [s]"""

class PlantOptions:
    """Disturbances of a quadrotor in flight; all off by default."""

    def __init__(self, *, motor_time_constant_s: float = 0.0, linear_drag: Sequence[float] = [0.0, 0.0, 0.0], quadratic_drag: Sequence[float] = [0.0, 0.0, 0.0], wind_m_s: Sequence[float] = [0.0, 0.0, 0.0], gust_m_s: Sequence[float] = [0.0, 0.0, 0.0], gust_time_s: float = 1.0, sensor: SensorOptions = ...) -> None:
        """
        Args:
            motor_time_constant_s: lag of the rotors; 0: none [s]
            linear_drag: linear drag along the body axes [N s/m]
            quadratic_drag: quadratic drag along the body axes [N s^2/m^2]
            wind_m_s: mean wind [m/s]
            gust_m_s: standard deviation of gusts per axis [m/s]
            gust_time_s: time constant of gusts [s]
            sensor: noise and delay of measurements
        """

    @property
    def motor_time_constant_s(self) -> float:
        """lag of the rotors; 0: none [s]"""

    @property
    def linear_drag(self) -> list[float]:
        """linear drag along the body axes [N s/m]"""

    @property
    def quadratic_drag(self) -> list[float]:
        """quadratic drag along the body axes [N s^2/m^2]"""

    @property
    def wind_m_s(self) -> list[float]:
        """mean wind [m/s]"""

    @property
    def gust_m_s(self) -> list[float]:
        """standard deviation of gusts per axis [m/s]"""

    @property
    def gust_time_s(self) -> float:
        """time constant of gusts [s]"""

    @property
    def sensor(self) -> SensorOptions:
        """noise and delay of measurements"""

class Plant:
    """
    A quadrotor in flight: alula/dynamics/plant.hpp. Off options make steps those of Quadrotor.
    """

    def __init__(self, quadrotor: Quadrotor, options: PlantOptions = ..., *, seed: int = 0, trial: int = 0) -> None: ...

    def reset(self, x: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)]) -> None: ...

    def step(self, dt_s: float, command: Annotated[NDArray[numpy.float64], dict(shape=(4), order='C', device='cpu', writable=False)]) -> None: ...

    def fly(self, dt_s: float, command: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """The states after steps with commands (N, 4), shape (N, 12)."""

    def switch_shadow(self) -> None: ...

    @property
    def state(self) -> NDArray[numpy.float64]: ...

    @property
    def measured(self) -> NDArray[numpy.float64]: ...

    @property
    def wrench(self) -> NDArray[numpy.float64]: ...

    @property
    def thrust(self) -> float: ...

    @property
    def acceleration(self) -> list[float]: ...

    @property
    def wind(self) -> list[float]: ...

    @property
    def time_s(self) -> float: ...

    @property
    def steps(self) -> int: ...

class DoubleIntegrator:
    """p' = v, v' = a with a held, stepped exactly."""

    def __init__(self, *, max_acceleration_m_s2: float = float('inf'), sensor: SensorOptions = ..., seed: int = 0, trial: int = 0) -> None: ...

    def reset(self, x: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)]) -> None: ...

    def step(self, dt_s: float, acceleration: Sequence[float]) -> None: ...

    @property
    def state(self) -> NDArray[numpy.float64]: ...

    @property
    def measured(self) -> NDArray[numpy.float64]: ...

    @property
    def acceleration(self) -> list[float]: ...

    @property
    def time_s(self) -> float: ...

    @property
    def steps(self) -> int: ...

class ActuatorModel:
    """Rotor lag and measurement age assumed by the controller and filters."""

    def __init__(self, *, motor_time_constant_s: float = 0.0, delay_s: float = 0.0, rate_time_constant_s: Sequence[float] = [0.0, 0.0, 0.0]) -> None:
        """
        Args:
            motor_time_constant_s: assumed lag of the rotors; 0: none [s]
            delay_s: assumed age of a measurement [s]
            rate_time_constant_s: of each axis of the rate loop, when commanded by body rates; 0 for all: commanded by wrenches [s]
        """

    @property
    def motor_time_constant_s(self) -> float:
        """assumed lag of the rotors; 0: none [s]"""

    @property
    def delay_s(self) -> float:
        """assumed age of a measurement [s]"""

    @property
    def rate_time_constant_s(self) -> list[float]:
        """
        of each axis of the rate loop, when commanded by body rates; 0 for all: commanded by wrenches [s]
        """

class StatePredictor:
    """
    Predicts the present state from an older measurement, by the model: alula/dynamics/state_predictor.hpp.
    """

    def __init__(self, body: Quadrotor, model: ActuatorModel, *, tick_s: float) -> None: ...

    def reset(self) -> None:
        """Reset to a history of hovering."""

    def now(self, measured: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)], age_s: float | None = None) -> NDArray[numpy.float64]:
        """
        Predict the present state (12,) from the state age_s ago; age_s is at most the model's delay, the default.
        """

    def fly(self, wrench: Annotated[NDArray[numpy.float64], dict(shape=(4), order='C', device='cpu', writable=False)], rates: Sequence[float] = [0.0, 0.0, 0.0], now: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)] | None = None) -> None:
        """
        Record a wrench that is commanded from now on for a tick [N, N m]; with a rate loop its thrust, the body rates [rad/s], and the predicted present state (12,).
        """

    def lead(self, wrench: Annotated[NDArray[numpy.float64], dict(shape=(4), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """
        Command with which the rotors reach a wrench by the end of a tick that begins now [N, N m].
        """

    @property
    def rotors(self) -> list[float]:
        """Thrust of each rotor now [N]."""

class ReferenceCurve:
    """
    Pieces of degree 7 of (x, y, z, yaw), as in `alula/plan`; at rest beyond its ends.
    """

    def __init__(self, time: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], coefficient: Annotated[NDArray[numpy.float64], dict(shape=(None, 4, 8), order='C', device='cpu', writable=False)]) -> None: ...

    def at(self, t: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """Rows (p, v, a, j, s, yaw, yaw', yaw'') at times (N,), shape (N, 18)."""

    @property
    def duration_s(self) -> float: ...

class TrackingGains:
    """
    Gains and limits of the geometric controller: alula/dynamics/tracking_controller.hpp.
    """

    def __init__(self, *, kp: float = 3.0, kv: float = 2.0, k_r: Sequence[float] = [0.35, 0.35, 0.12], k_omega: Sequence[float] = [0.025, 0.025, 0.012], catch_up_m_s: float = float('inf'), max_tilt_rad: float = float('inf'), max_thrust_share: float = float('inf'), uses_acceleration: bool = True) -> None:
        """
        Args:
            kp: gain of the position error [1/s^2]
            kv: gain of the velocity error [1/s]
            k_r: gains of the attitude error [N m]
            k_omega: gains of the rate error [N m s]
            catch_up_m_s: limit of kp |e_p| / kv [m/s]
            max_tilt_rad: maximum tilt of the commanded force [rad]
            max_thrust_share: maximum commanded force, as a fraction of the rotors' thrust
            uses_acceleration: errors of acceleration and jerk enter the derivatives of the force
        """

    @property
    def kp(self) -> float:
        """gain of the position error [1/s^2]"""

    @property
    def kv(self) -> float:
        """gain of the velocity error [1/s]"""

    @property
    def k_r(self) -> list[float]:
        """gains of the attitude error [N m]"""

    @property
    def k_omega(self) -> list[float]:
        """gains of the rate error [N m s]"""

    @property
    def catch_up_m_s(self) -> float:
        """limit of kp |e_p| / kv [m/s]"""

    @property
    def max_tilt_rad(self) -> float:
        """maximum tilt of the commanded force [rad]"""

    @property
    def max_thrust_share(self) -> float:
        """maximum commanded force, as a fraction of the rotors' thrust"""

    @property
    def uses_acceleration(self) -> bool:
        """errors of acceleration and jerk enter the derivatives of the force"""

def track(quadrotor: Quadrotor, gains: TrackingGains, x: Annotated[NDArray[numpy.float64], dict(shape=(None, 12), order='C', device='cpu', writable=False)], reference: Annotated[NDArray[numpy.float64], dict(shape=(None, 18), order='C', device='cpu', writable=False)], *, applied_thrust: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None) -> dict[str, NDArray[numpy.float64]]:
    """
    The geometric controller at states (N, 12) and references (N, 18): per row its wrench, acceleration, derivatives of the thrust and all intermediate terms.
    """

def track_point(gains: TrackingGains, x: Annotated[NDArray[numpy.float64], dict(shape=(None, 12), order='C', device='cpu', writable=False)], reference: Annotated[NDArray[numpy.float64], dict(shape=(None, 18), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
    """Accelerations (N, 3) of the controller of a point [m/s^2]."""

def realise(quadrotor: Quadrotor, gains: TrackingGains, x: Annotated[NDArray[numpy.float64], dict(shape=(None, 12), order='C', device='cpu', writable=False)], reference: Annotated[NDArray[numpy.float64], dict(shape=(None, 18), order='C', device='cpu', writable=False)], acceleration: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], *, applied_thrust: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None) -> NDArray[numpy.float64]:
    """
    Wrenches (N, 4) that make accelerations (N, 3) through the attitude loop.
    """

def body_rates(quadrotor: Quadrotor, x: Annotated[NDArray[numpy.float64], dict(shape=(None, 12), order='C', device='cpu', writable=False)], u: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)], *, dt_s: float, max_rate_rad_s: Sequence[float]) -> NDArray[numpy.float64]:
    """Commanded rates (N, 3) for a rate loop [rad/s]."""

class QpResult:
    """Answer of `QpSolver.solve`."""

    @property
    def status(self) -> int:
        """0 optimal, 1 infeasible, 2 failed."""

    @property
    def x(self) -> NDArray[numpy.float64]:
        """The minimiser, shape (n,); zero unless optimal."""

    @property
    def active(self) -> NDArray[numpy.uint32]:
        """Rows with a multiplier, ascending."""

    @property
    def multipliers(self) -> NDArray[numpy.float64]:
        """
        Multipliers y of these rows: hessian x + gradient = rows^T y, or the certificate.
        """

    @property
    def violation(self) -> float:
        """
        Largest (b_i - a_i . x) / |a_i|, at least 0; when infeasible a lower bound for every x; infinite when failed.
        """

    @property
    def iterations(self) -> int:
        """Number of exchanges."""

class QpSolver:
    """
    Solver of min 1/2 x^T H x + g^T x with rows x >= bounds; dense, up to 10 variables, active set.
    """

    def __init__(self, backend: object | None = None) -> None:
        """
        `backend(hessian, gradient, rows, bounds) -> (status, x, active, multipliers)` solves instead, if given.
        """

    def solve(self, hessian: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], gradient: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], rows: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], bounds: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], warm: Annotated[NDArray[numpy.uint32], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None) -> QpResult:
        """
        Solve one problem; `warm` lists rows that are probably active. ValueError when shapes do not fit.
        """

    def solve_many(self, hessian: Annotated[NDArray[numpy.float64], dict(shape=(None, None, None), order='C', device='cpu', writable=False)], gradient: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], rows: Annotated[NDArray[numpy.float64], dict(shape=(None, None, None), order='C', device='cpu', writable=False)], bounds: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], warm: Annotated[NDArray[numpy.uint32], dict(shape=(None, None), order='C', device='cpu', writable=False)] | None = None, repeats: int = 1) -> dict[str, Any]:
        """
        Solve a stack of problems in order: arrays `status` (k,), `x` (k, n), `active` and `multipliers` (k, n + 1), filled up with -1 and 0, `violation`, `iterations` and `elapsed_ns` (k,), the minimum of `repeats`. `warm` (k, w) lists rows; numbers beyond the rows are ignored.
        """

class EllipsoidIndex:
    """
    Index of the Gaussians' ellipsoids for distance queries; each is also grown by the vehicle's sphere.
    """

    def __init__(self, mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], quat_wxyz: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), order='C', device='cpu', writable=False)], *, sigma: float, radius: float, loss: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None) -> None:
        """
        Copy the Gaussians; the ellipsoids are at level sigma, each grown by `loss` (N, 3).
        """

    def __len__(self) -> int: ...

    @property
    def radius(self) -> float: ...

    def nearest(self, a: Sequence[float], b: Sequence[float], *, reach: float, count: int) -> tuple[NDArray[numpy.int64], NDArray[numpy.float64]]:
        """
        Numbers and signed distances of the `count` ungrown ellipsoids nearest to the segment a..b, of those nearer than `reach`, nearest first.
        """

    def clearance(self, points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], *, cap: float = float('inf'), jobs: int = 0, progress: object | None = None) -> NDArray[numpy.float64]:
        """
        Signed distance of each point (N, 3) to the nearest ungrown ellipsoid, at most `cap`.
        """

    def grown(self) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]:
        """
        Centres (N, 3) and matrices A (N, 3, 3) of the grown ellipsoids {y : (y - c)^T A (y - c) <= 1}.
        """

def least_gamma(index: EllipsoidIndex, points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> float:
    """
    Minimum r' A r - 1 over the grown ellipsoids and the points (T, 3); below 0 inside one.
    """

class Pruning:
    """Selection of the ellipsoids that become rows of a tick."""

    def __init__(self, *, reaction_time_s: float = 0.3, max_deceleration: float = 6.0, floor_m: float = 0.5, count: int = 64, prune_ticks: int = 1, gate: bool = True, approach: bool = True, sweep: bool = True) -> None:
        """
        Args:
            reaction_time_s: reaction time t of the distance gate [s]
            max_deceleration: deceleration a of the distance gate [m/s^2]
            floor_m: minimum of the distance gate [m]
            count: maximum number of rows, nearest ellipsoids first; 0: every ellipsoid within the gate
            prune_ticks: calls of the filter for which the candidates are kept before the gate looks for new ones
            gate: use the distance gate; false: every ellipsoid of the map, for ablations
            approach: only ellipsoids that the vehicle approaches, r^T A v >= 0
            sweep: rank ellipsoids by their distance to the segment that the vehicle sweeps while it reacts and brakes; false: by their distance to its position
        """

    @property
    def reaction_time_s(self) -> float:
        """reaction time t of the distance gate [s]"""

    @property
    def max_deceleration(self) -> float:
        """deceleration a of the distance gate [m/s^2]"""

    @property
    def floor_m(self) -> float:
        """minimum of the distance gate [m]"""

    @property
    def count(self) -> int:
        """
        maximum number of rows, nearest ellipsoids first; 0: every ellipsoid within the gate
        """

    @property
    def prune_ticks(self) -> int:
        """
        calls of the filter for which the candidates are kept before the gate looks for new ones
        """

    @property
    def gate(self) -> bool:
        """
        use the distance gate; false: every ellipsoid of the map, for ablations
        """

    @property
    def approach(self) -> bool:
        """only ellipsoids that the vehicle approaches, r^T A v >= 0"""

    @property
    def sweep(self) -> bool:
        """
        rank ellipsoids by their distance to the segment that the vehicle sweeps while it reacts and brakes; false: by their distance to its position
        """

class SafetyFilter:
    """Safety filter of one kind of command; one per thread."""

    def filter(self, state: Sequence[float], acceleration: Sequence[float], *, thrust: float = 0.0, thrust_rate: float = 0.0, rotors: Sequence[float] | None = None, position_variance: Sequence[float] = [0.0, 0.0, 0.0], is_known: bool = True, velocity: Sequence[float] = [0.0, 0.0, 0.0], wrench: Sequence[float] = [0.0, 0.0, 0.0, 0.0], nominal_thrust_rate: float = 0.0, nominal_thrust_acceleration: float = 0.0, position_error: Sequence[float] = [0.0, 0.0, 0.0], velocity_error: Sequence[float] = [0.0, 0.0, 0.0], reference_acceleration: Sequence[float] = [0.0, 0.0, 0.0], sticks: Sequence[float] | None = None, tracks: numpy.typing.NDArray[numpy.float64] | None = None) -> dict[str, Any]:
        """
        Filter one tick at a state (p, sigma, v, omega) with the nominal acceleration [m/s^2]; returns a dict of FilterReport.

        Args:
            thrust: last applied thrust [N]
            thrust_rate: its rate [N/s]
            rotors: thrust of each rotor now [N]; None: the rotors hover
            position_variance: of the state's position, per axis [m^2]
            is_known: false: there is no navigation, and the state means nothing
            velocity: nominal velocity [m/s]
            wrench: nominal thrust and torque [N, N m]
            nominal_thrust_rate: rate of the nominal thrust [N/s]
            nominal_thrust_acceleration: its second derivative [N/s^2]
            position_error: position minus that of the reference [m]
            velocity_error: velocity minus that of the reference [m/s]
            reference_acceleration: acceleration of the reference [m/s^2]
            sticks: throttle and body rates [rad/s]; None: the pilot is silent
            tracks: what moves, predicted to now, (N, 29): id, position, velocity, the lower triangle of their covariance row by row, radius; (N, 32): acceleration too
        """

    def reset(self) -> None:
        """Clear warm starts and commitments before another flight."""

    def clone(self) -> SafetyFilter: ...

    @property
    def kind(self) -> str:
        """
        Command that it changes and returns: velocity, acceleration, wrench or sticks.
        """

    @property
    def shares_state(self) -> bool:
        """
        Whether its clones share its state, as those of a filter in Python: flights run in one thread.
        """

class ConeDiOptions:
    """Options of the filter cone-di."""

    def __init__(self, *, alpha: float = 5.0, recovery: float = 3.0, swell: float = 0.01, escape_rate: float = 5.0, min_speed: float = 0.05, max_acceleration: float = float('inf'), max_braking: float = 6.0, lateral_bias: float = 0.5, clf_weight: float = 0.0, clf_rate: float = 0.5, clf_kp: float = 3.0, clf_kv: float = 2.0, pruning: Pruning = ...) -> None:
        """
        Args:
            alpha: gain of h' >= -alpha h [1/s]
            recovery: where h < 0, alpha is at least this over the time to contact; 0: never, as printed
            swell: rows are of ellipsoids whose semi-axes are longer by this fraction
            escape_rate: double pole k of the rows gamma'' + 2 k gamma' + k^2 gamma >= 0 [1/s]
            min_speed: speed below which rows are on gamma, as h has no direction [m/s]
            max_acceleration: maximum acceleration on each axis [m/s^2]
            max_braking: deceleration of the fallback [m/s^2]
            lateral_bias: lateral acceleration added to a nominal input that a head-on cone only lets brake [m/s^2]
            clf_weight: weight of the slack xi of the tracking row; 0: no tracking row
            clf_rate: decay rate c of the tracking row [1/s]
            clf_kp: position gain of the closed loop that defines V [1/s^2]
            clf_kv: velocity gain of the closed loop that defines V [1/s]
            pruning: Which ellipsoids become rows of the program in a tick: the distance gate v^2 / (2 a) + v t + radius, and what is within it.
        """

    @property
    def alpha(self) -> float:
        """gain of h' >= -alpha h [1/s]"""

    @property
    def recovery(self) -> float:
        """
        where h < 0, alpha is at least this over the time to contact; 0: never, as printed
        """

    @property
    def swell(self) -> float:
        """rows are of ellipsoids whose semi-axes are longer by this fraction"""

    @property
    def escape_rate(self) -> float:
        """double pole k of the rows gamma'' + 2 k gamma' + k^2 gamma >= 0 [1/s]"""

    @property
    def min_speed(self) -> float:
        """speed below which rows are on gamma, as h has no direction [m/s]"""

    @property
    def max_acceleration(self) -> float:
        """maximum acceleration on each axis [m/s^2]"""

    @property
    def max_braking(self) -> float:
        """deceleration of the fallback [m/s^2]"""

    @property
    def lateral_bias(self) -> float:
        """
        lateral acceleration added to a nominal input that a head-on cone only lets brake [m/s^2]
        """

    @property
    def clf_weight(self) -> float:
        """weight of the slack xi of the tracking row; 0: no tracking row"""

    @property
    def clf_rate(self) -> float:
        """decay rate c of the tracking row [1/s]"""

    @property
    def clf_kp(self) -> float:
        """position gain of the closed loop that defines V [1/s^2]"""

    @property
    def clf_kv(self) -> float:
        """velocity gain of the closed loop that defines V [1/s]"""

    @property
    def pruning(self) -> Pruning:
        """
        Which ellipsoids become rows of the program in a tick: the distance gate v^2 / (2 a) + v t + radius, and what is within it.
        """

class ConeDi(SafetyFilter):
    """The collision cone filter of a double integrator."""

    def __init__(self, index: EllipsoidIndex, options: ConeDiOptions = ..., *, qp_backend: object | None = None) -> None:
        """qp_backend: as of QpSolver."""

    @property
    def options(self) -> ConeDiOptions: ...

class SaferSplatOptions:
    """Options of the filter safer-splat."""

    def __init__(self, *, alpha: float = 5.0, beta: float = 1.0, hessian: str = 'correct', rows: str = 'all', brute: bool = False, max_braking: float = 6.0, max_acceleration: float = float('inf'), pruning: Pruning = ...) -> None:
        """
        Args:
            alpha: first pole of h'' + (alpha + beta) h' + alpha beta h >= 0 [1/s]
            beta: second pole of the same row [1/s]
            hessian: Hessian of the squared distance
            rows: ellipsoids that have rows
            brute: measure every ellipsoid instead of querying the index
            max_braking: deceleration of the fallback [m/s^2]
            max_acceleration: maximum acceleration on each axis [m/s^2]
            pruning: Which ellipsoids become rows of the program in a tick: the distance gate v^2 / (2 a) + v t + radius, and what is within it.
        """

    @property
    def alpha(self) -> float:
        """first pole of h'' + (alpha + beta) h' + alpha beta h >= 0 [1/s]"""

    @property
    def beta(self) -> float:
        """second pole of the same row [1/s]"""

    @property
    def hessian(self) -> str:
        """Hessian of the squared distance"""

    @property
    def rows(self) -> str:
        """ellipsoids that have rows"""

    @property
    def brute(self) -> bool:
        """measure every ellipsoid instead of querying the index"""

    @property
    def max_braking(self) -> float:
        """deceleration of the fallback [m/s^2]"""

    @property
    def max_acceleration(self) -> float:
        """maximum acceleration on each axis [m/s^2]"""

    @property
    def pruning(self) -> Pruning:
        """
        Which ellipsoids become rows of the program in a tick: the distance gate v^2 / (2 a) + v t + radius, and what is within it.
        """

class SaferSplat(SafetyFilter):
    """The distance filter of SAFER-Splat for a double integrator."""

    def __init__(self, index: EllipsoidIndex, options: SaferSplatOptions = ..., *, near_map: ObstacleMap | None = None, near_radius_m: float | None = None) -> None:
        """
        near_map: obstacles that have rows besides those of the index; near_radius_m: the distance from them, default the radius of the index.
        """

    @property
    def options(self) -> SaferSplatOptions: ...

    def barrier(self, item: int, p: Sequence[float], v: Sequence[float]) -> tuple[float, list[float], float]:
        """h, row and bound of one ellipsoid: row . a >= bound."""

    def unsure(self, p: Sequence[float], v: Sequence[float], acceleration: Sequence[float]) -> NDArray[numpy.int64]:
        """
        Numbers of the ellipsoids that may have a row that `acceleration` violates, according to the index.
        """

def collision_cone(centre: Sequence[float], a: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C', device='cpu', writable=False)], p: Sequence[float], v: Sequence[float], *, acceleration: Sequence[float], jerk: Sequence[float]) -> dict[str, Any]:
    """
    The collision cone of {y : (y - centre)^T a (y - centre) <= 1} and its derivatives along a flight.
    """

def snap_rows(body: Quadrotor, state: Sequence[float], *, thrust: float, thrust_rate: float, centre: Sequence[float], a: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C', device='cpu', writable=False)], rate: float) -> dict[str, Any]:
    """
    Map from (T'' / m, tau) to the snap, and the rows of third and fourth order of one ellipsoid over it.
    """

class BackupGains:
    """Gains of a backup policy."""

    def __init__(self, *, k_vz: float = 2.0, k_sigma: float = 0.3, k_omega: float = 0.02, k_vh: float = 0.006, kappa: float = 1.0, weight: Sequence[float] = [2.0, 0.3, 0.3, 0.05], eta_frac: float = 0.95, tilt_rad: float = 0.61, full_tilt_speed_m_s: float = 1.5, climb_rate_1_s: float = 4.0, attitude_rad_s: float = 20.0, attitude_damping: float = 0.9, yaw_damping_1_s: float = 8.0, torque_share: float = 0.4, torque_weight: Sequence[float] = [0.3, 0.3, 0.03]) -> None:
        """
        Args:
            k_vz: gain of the vertical speed (hover, heading-invariant) [1/s]
            k_sigma: gain K_sigma of the attitude (hover, heading-invariant) [N m]
            k_omega: gain K_omega of the angular velocity (hover, heading-invariant) [N m s]
            k_vh: gain of the horizontal velocity (hover, heading-invariant) [N s]
            kappa: sharpness of the saturation (hover, heading-invariant)
            weight: caps of thrust and torques relative to each other (hover, heading-invariant) [N, N m]
            eta_frac: fraction of the rotors' margin about hover that the policy uses
            tilt_rad: maximum steady tilt, at most 1.2 (brake, cone-escape) [rad]
            full_tilt_speed_m_s: speed scale v_0 of the tilt (brake, cone-escape) [m/s]
            climb_rate_1_s: gain k_z of the vertical speed (brake, cone-escape) [1/s]
            attitude_rad_s: natural frequency w of roll and pitch, K_R = J w^2 (brake, cone-escape) [rad/s]
            attitude_damping: damping ratio zeta of roll and pitch, K_omega = 2 zeta w J (brake, cone-escape)
            yaw_damping_1_s: gain of the yaw rate, K_omega = J_z times this (brake, cone-escape) [1/s]
            torque_share: fraction of the rotors' downward margin for torques; the rest is for thrust (brake, cone-escape)
            torque_weight: caps of the torques relative to each other (brake, cone-escape) [N m]
        """

    @property
    def k_vz(self) -> float:
        """gain of the vertical speed (hover, heading-invariant) [1/s]"""

    @property
    def k_sigma(self) -> float:
        """gain K_sigma of the attitude (hover, heading-invariant) [N m]"""

    @property
    def k_omega(self) -> float:
        """
        gain K_omega of the angular velocity (hover, heading-invariant) [N m s]
        """

    @property
    def k_vh(self) -> float:
        """gain of the horizontal velocity (hover, heading-invariant) [N s]"""

    @property
    def kappa(self) -> float:
        """sharpness of the saturation (hover, heading-invariant)"""

    @property
    def weight(self) -> list[float]:
        """
        caps of thrust and torques relative to each other (hover, heading-invariant) [N, N m]
        """

    @property
    def eta_frac(self) -> float:
        """fraction of the rotors' margin about hover that the policy uses"""

    @property
    def tilt_rad(self) -> float:
        """maximum steady tilt, at most 1.2 (brake, cone-escape) [rad]"""

    @property
    def full_tilt_speed_m_s(self) -> float:
        """speed scale v_0 of the tilt (brake, cone-escape) [m/s]"""

    @property
    def climb_rate_1_s(self) -> float:
        """gain k_z of the vertical speed (brake, cone-escape) [1/s]"""

    @property
    def attitude_rad_s(self) -> float:
        """
        natural frequency w of roll and pitch, K_R = J w^2 (brake, cone-escape) [rad/s]
        """

    @property
    def attitude_damping(self) -> float:
        """
        damping ratio zeta of roll and pitch, K_omega = 2 zeta w J (brake, cone-escape)
        """

    @property
    def yaw_damping_1_s(self) -> float:
        """
        gain of the yaw rate, K_omega = J_z times this (brake, cone-escape) [1/s]
        """

    @property
    def torque_share(self) -> float:
        """
        fraction of the rotors' downward margin for torques; the rest is for thrust (brake, cone-escape)
        """

    @property
    def torque_weight(self) -> list[float]:
        """caps of the torques relative to each other (brake, cone-escape) [N m]"""

class BackupPolicy:
    """Feedback that brings a quadrotor to rest within its rotors' limits."""

    def __init__(self, vehicle: Quadrotor, kind: str = 'brake', gains: BackupGains = ...) -> None:
        """
        A policy of the kind hover, heading-invariant, brake or cone-escape (which is brake as a policy). ValueError unless braking is stable.
        """

    @property
    def kind(self) -> str: ...

    @property
    def cap_up(self) -> float:
        """Maximum thrust above hover [N]."""

    @property
    def cap_down(self) -> float:
        """Maximum reduction of the thrust below hover [N]."""

    @property
    def torque_cap(self) -> list[float]:
        """Maximum torques [N m]."""

    def raw(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)], hold: Sequence[float] = [0.0, 0.0, 0.0]) -> NDArray[numpy.float64]:
        """(T, tau) before saturation [N, N m]."""

    def __call__(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)], hold: Sequence[float] = [0.0, 0.0, 0.0]) -> NDArray[numpy.float64]:
        """
        (T, tau) at a state (12,) = (p, sigma, v, omega), regulating about `hold` [m/s].
        """

    def urgent(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)], hold: Sequence[float] = [0.0, 0.0, 0.0]) -> NDArray[numpy.float64]:
        """
        The same with the rotors' full range, for states where no gentle manoeuvre is safe.
        """

    def closed_loop(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)], hold: Sequence[float] = [0.0, 0.0, 0.0]) -> NDArray[numpy.float64]:
        """f + g pi_b, shape (12,)."""

    def jacobian(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)], hold: Sequence[float] = [0.0, 0.0, 0.0]) -> NDArray[numpy.float64]:
        """Derivative of `closed_loop` by the state, shape (12, 12)."""

    def drift(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float64]:
        """
        Distance that the linear loop about hover would still move before it rests [m].
        """

    def excursion(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)]) -> float:
        """
        Approximate maximum distance before it rests, without the cancellation in `drift` [m].
        """

class BackupFlow:
    """Flow of a backup policy and its sensitivity to the present input."""

    def __init__(self, policy: BackupPolicy, *, horizon_s: float = 1.5, nodes: int = 20, steps: int = 1, drift: bool = False) -> None:
        """
        `steps` RK4 steps between nodes; with `drift` the column Q f is integrated, else it is f_cl - W pi_b.
        """

    def run(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)], hold: Sequence[float] = [0.0, 0.0, 0.0], hold_steps: int = 0) -> None:
        """Fly about `hold` [m/s] for that many RK4 steps, then to rest."""

    def states(self) -> NDArray[numpy.float64]:
        """Phi_k, shape (nodes + 1, 12)."""

    def sensitivities(self) -> NDArray[numpy.float64]:
        """W_k = Q_k g(x), shape (nodes + 1, 12, 4)."""

    def drifts(self) -> NDArray[numpy.float64]:
        """Q_k f(x), shape (nodes + 1, 12)."""

    def running_row(self, centre: Sequence[float], a: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C', device='cpu', writable=False)], k: int, alpha: float) -> tuple[list[float], float]:
        """
        (a, b) of a . u >= b: h' + alpha h >= 0 of the cone of {y : (y - centre)' a (y - centre) <= 1} at node k.
        """

    def clear_row(self, centre: Sequence[float], a: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C', device='cpu', writable=False)], k: int, alpha: float) -> tuple[list[float], float]:
        """The same row for gamma' + alpha gamma >= 0."""

class ObstacleMap:
    """A static map of obstacles: alula/geometry/obstacle_map.hpp."""

    def distance(self, points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], upto: float = float('inf')) -> NDArray[numpy.float64]:
        """
        Signed distance of each point where it is below `upto`, else some number of at least `upto`.
        """

    def segment_distance(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], end: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], upto: float) -> NDArray[numpy.float64]:
        """
        Distance of each segment where it is below `upto`, else some number of at least `upto`; 0 in contact.
        """

    def is_clear(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], end: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], radius: float) -> NDArray[numpy.bool_]:
        """
        Whether the ball swept from start[i] to end[i] is free; never wrongly true.
        """

    def near(self, point: Sequence[float], reach: float, most: int) -> dict[str, Any]:
        """
        The at most `most` obstacles nearer than `reach`, nearest first: kind, index, distance, normal, point.
        """

class EllipsoidMap(ObstacleMap):
    """The ungrown ellipsoids of an index."""

    def __init__(self, index: EllipsoidIndex) -> None: ...

class EllipsoidSetMap(ObstacleMap):
    """The ellipsoids of a set, without an index."""

    def __init__(self, set: EllipsoidSet) -> None: ...

class HullMap(ObstacleMap):
    """Convex hulls."""

    def __init__(self, hulls: PolytopeSet) -> None: ...

class FenceMap(ObstacleMap):
    """A convex polytope whose inside is free."""

    def __init__(self, normals: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], offsets: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None:
        """The polytope {x : normal . x <= offset} with unit normals."""

class ImageMap(ObstacleMap):
    """The image of an onboard map, read in place."""

    def __init__(self, image: bytes) -> None: ...

class GrownMap(ObstacleMap):
    """The obstacles of a map, grown by a length."""

    def __init__(self, map: ObstacleMap, by: float) -> None: ...

class MapUnion(ObstacleMap):
    """All obstacles of several maps."""

    def __init__(self, maps: Sequence[ObstacleMap]) -> None: ...

class ShieldOptions:
    """Options of the check of a manoeuvre to rest."""

    def __init__(self, *, tick_s: float = 0.01, substeps: int = 1, margin_m: float = 0.02, max_time_s: float = 8.0, escape_time_s: float = 0.6, escape_tries: int = 3, line_search: int = 2, rest_speed_m_s: float = 0.1, rest_rate_rad_s: float = 0.2, rest_tilt_rad: float = 0.05, rest_drift_m: float = 0.008, early_end: bool = True, motor_time_constant_s: float = 0.0, rate_time_constant_s: Sequence[float] = [0.0, 0.0, 0.0], max_rate_rad_s: Sequence[float] = [10.0, 10.0, 4.0], tube_horizon_s: float = 1.0, tube_risk: float = 0.05, tube_acceleration_m_s2: float = 2.0) -> None:
        """
        Args:
            tick_s: how long an input is held [s]
            substeps: minimum number of RK4 steps in a tick; no step is longer than 10 ms
            margin_m: distance beyond the radius that a new manoeuvre keeps until it rests; one being flown stays accepted down to half of it, and the radius is what is guaranteed [m]
            max_time_s: a manoeuvre that is not at rest by then is not safe; a new one gets an eighth less [s]
            escape_time_s: how long the policy cone-escape holds a velocity [s]
            escape_tries: maximum number of velocities that cone-escape tries, smallest turn first
            line_search: bisections between the input of the backup policy and a refused input
            rest_speed_m_s: speed below which the vehicle can count as at rest [m/s]
            rest_rate_rad_s: angular rate below which the vehicle can count as at rest [rad/s]
            rest_tilt_rad: tilt below which the vehicle can count as at rest [rad]
            rest_drift_m: maximum remaining drift of the linear loop about hover at rest; below half of margin_m [m]
            early_end: end rollouts before rest where a ball of twice the linear loop's excursion is free, which is tested and not proven; false: every manoeuvre is rolled out to rest
            motor_time_constant_s: assumed time constant of the rotors; 0: rotors follow a command at once [s]
            rate_time_constant_s: time constant of each axis of the rate loop of a vehicle that is commanded by thrust and body rates; 0 for all: it is commanded by thrust and torque [s]
            max_rate_rad_s: maximum body rates of a command [rad/s]
            tube_horizon_s: how far ahead manoeuvres keep clear of the tubes of moving obstacles, where they can [s]
            tube_risk: probability at each time that a moving obstacle is not within its tube in the direction of the vehicle, for any distribution with the covariance of its track
            tube_acceleration_m_s2: maximum acceleration of a moving obstacle, by which its tube grows [m/s^2]
        """

    @property
    def tick_s(self) -> float:
        """how long an input is held [s]"""

    @property
    def substeps(self) -> int:
        """minimum number of RK4 steps in a tick; no step is longer than 10 ms"""

    @property
    def margin_m(self) -> float:
        """
        distance beyond the radius that a new manoeuvre keeps until it rests; one being flown stays accepted down to half of it, and the radius is what is guaranteed [m]
        """

    @property
    def max_time_s(self) -> float:
        """
        a manoeuvre that is not at rest by then is not safe; a new one gets an eighth less [s]
        """

    @property
    def escape_time_s(self) -> float:
        """how long the policy cone-escape holds a velocity [s]"""

    @property
    def escape_tries(self) -> int:
        """
        maximum number of velocities that cone-escape tries, smallest turn first
        """

    @property
    def line_search(self) -> int:
        """bisections between the input of the backup policy and a refused input"""

    @property
    def rest_speed_m_s(self) -> float:
        """speed below which the vehicle can count as at rest [m/s]"""

    @property
    def rest_rate_rad_s(self) -> float:
        """angular rate below which the vehicle can count as at rest [rad/s]"""

    @property
    def rest_tilt_rad(self) -> float:
        """tilt below which the vehicle can count as at rest [rad]"""

    @property
    def rest_drift_m(self) -> float:
        """
        maximum remaining drift of the linear loop about hover at rest; below half of margin_m [m]
        """

    @property
    def early_end(self) -> bool:
        """
        end rollouts before rest where a ball of twice the linear loop's excursion is free, which is tested and not proven; false: every manoeuvre is rolled out to rest
        """

    @property
    def motor_time_constant_s(self) -> float:
        """
        assumed time constant of the rotors; 0: rotors follow a command at once [s]
        """

    @property
    def rate_time_constant_s(self) -> list[float]:
        """
        time constant of each axis of the rate loop of a vehicle that is commanded by thrust and body rates; 0 for all: it is commanded by thrust and torque [s]
        """

    @property
    def max_rate_rad_s(self) -> list[float]:
        """maximum body rates of a command [rad/s]"""

    @property
    def tube_horizon_s(self) -> float:
        """
        how far ahead manoeuvres keep clear of the tubes of moving obstacles, where they can [s]
        """

    @property
    def tube_risk(self) -> float:
        """
        probability at each time that a moving obstacle is not within its tube in the direction of the vehicle, for any distribution with the covariance of its track
        """

    @property
    def tube_acceleration_m_s2(self) -> float:
        """
        maximum acceleration of a moving obstacle, by which its tube grows [m/s^2]
        """

class Shield:
    """Checks that a safe manoeuvre to rest exists: alula/filters/shield.hpp."""

    @overload
    def __init__(self, policy: BackupPolicy, index: EllipsoidIndex, options: ShieldOptions = ...) -> None:
        """For the ellipsoids of an index and its radius."""

    @overload
    def __init__(self, policy: BackupPolicy, map: ObstacleMap, radius_m: float, options: ShieldOptions = ...) -> None:
        """For a ball of radius_m in any map."""

    @property
    def ends_early(self) -> bool:
        """
        True when rollouts for a verdict end where the policy's excursion is free all around.
        """

    def certify(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)], *, first: Sequence[float] | None = None, hold: Sequence[float] = [0.0, 0.0, 0.0], hold_ticks: int = 0, margin_m: float | None = None, thorough: bool = False) -> dict[str, Any]:
        """
        Fly one tick of the wrench `first`, if given, then about `hold` [m/s] for hold_ticks, then to rest: a dict of safe, rests, clearance_m (minimum distance minus the radius), time_s and clears_tubes.
        """

    def after(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)], wrench: Sequence[float]) -> NDArray[numpy.float64]:
        """State one tick later."""

    def see(self, rotors: Sequence[float] | None = None, tracks: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)] | None = None, position_variance: Sequence[float] = [0.0, 0.0, 0.0], disturbance_m_s2: Sequence[float] = [0.0, 0.0, 0.0]) -> None:
        """
        Set the thrust of each rotor [N] for the next states, the tracks from now on, as of MovingFilter, the variance of the position [m^2], and the disturbance [m/s^2] for which the attitudes of states are levelled.
        """

def escape_velocities(index: EllipsoidIndex, p: Sequence[float], v: Sequence[float], *, reach: float, count: int = 64, slack_rad: float = 0.05) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]:
    """
    Velocities (N, 3) of the same speed that meet no cone of the ellipsoids within reach, and the angles [rad] by which they are turned, smallest first.
    """

class SmoothNominalOptions:
    """
    The smooth nominal input of a filter of wrenches while rows hold the vehicle.
    """

    def __init__(self, *, release_rad_s: float = 2.0, release_growth_1_s: float = 3.0, nominal_attitude_rad_s: float = 35.0, nominal_position_rad_s: float = 1.2, nominal_catch_up_m_s: float = 0.7, nominal_acceleration: float = 3.0, nominal_speed_m_s: float = 2.2, nominal_cone_rate_1_s: float = 3.0) -> None:
        """
        Args:
            release_rad_s: pole p1 of the acceleration while rows hold the vehicle back; 0: the nominal input is used unchanged [rad/s]
            release_growth_1_s: exponential growth rate of p1 after the release [1/s]
            nominal_attitude_rad_s: pole p2 of the acceleration, and final value of p1; above release_rad_s [rad/s]
            nominal_position_rad_s: double pole q of the position; grows with the reference's speed above nominal_speed_m_s [rad/s]
            nominal_catch_up_m_s: maximum speed above the reference's to make up for the position error; grows with its speed above nominal_speed_m_s [m/s]
            nominal_acceleration: maximum acceleration in response to position and velocity errors; grows with the reference's speed above nominal_speed_m_s [m/s^2]
            nominal_speed_m_s: reference speed of the three values before; for a reference n times as fast they are n^1.5 times as large [m/s]
            nominal_cone_rate_1_s: rate of the first-order cone rows that the target acceleration holds [1/s]
        """

    @property
    def release_rad_s(self) -> float:
        """
        pole p1 of the acceleration while rows hold the vehicle back; 0: the nominal input is used unchanged [rad/s]
        """

    @property
    def release_growth_1_s(self) -> float:
        """exponential growth rate of p1 after the release [1/s]"""

    @property
    def nominal_attitude_rad_s(self) -> float:
        """
        pole p2 of the acceleration, and final value of p1; above release_rad_s [rad/s]
        """

    @property
    def nominal_position_rad_s(self) -> float:
        """
        double pole q of the position; grows with the reference's speed above nominal_speed_m_s [rad/s]
        """

    @property
    def nominal_catch_up_m_s(self) -> float:
        """
        maximum speed above the reference's to make up for the position error; grows with its speed above nominal_speed_m_s [m/s]
        """

    @property
    def nominal_acceleration(self) -> float:
        """
        maximum acceleration in response to position and velocity errors; grows with the reference's speed above nominal_speed_m_s [m/s^2]
        """

    @property
    def nominal_speed_m_s(self) -> float:
        """
        reference speed of the three values before; for a reference n times as fast they are n^1.5 times as large [m/s]
        """

    @property
    def nominal_cone_rate_1_s(self) -> float:
        """
        rate of the first-order cone rows that the target acceleration holds [1/s]
        """

class ConeEcbfOptions:
    """Options of the filter cone-ecbf."""

    def __init__(self, *, lambda_: float = 14.0, lambda_max: float = 40.0, return_time: float = 8.0, escape_rate: float = 5.0, min_speed_m_s: float = 0.8, cascade: str = 'extension', thrust_bandwidth_rad_s: float = 30.0, thrust_damping: float = 1.0, max_thrust_rate_n_s: float = 150.0, least_thrust: float = 0.1, lateral_bias: float = 0.1, shield: bool = True, room_m: float = 0.08, try_nominal: bool = True, smooth_nominal: SmoothNominalOptions = ..., clf_weight: float = 0.0, clf_rate: float = 1.0, clf_kp: float = 3.0, clf_kv: float = 2.0, shield_options: ShieldOptions = ..., pruning: Pruning = ...) -> None:
        """
        Args:
            lambda_: triple pole of the rows; poles slower than the time to contact brake early, much faster ones turn too late [1/s]
            lambda_max: limit to which the pole of a row is moved left when it starts beyond its safe set; at least lambda_ [1/s]
            return_time: pole of a row with h < 0 times the time to its ellipsoid; the pole stays within lambda_ and lambda_max
            escape_rate: pole of the rows on gamma [1/s]
            min_speed_m_s: speed below which the rows of all ellipsoids are on gamma [m/s]
            cascade: how the thrust enters the snap
            thrust_bandwidth_rad_s: bandwidth w with which the thrust follows its nominal value; w dt must be below 1 [rad/s]
            thrust_damping: damping ratio zeta of the same
            max_thrust_rate_n_s: maximum |T'| [N/s]
            least_thrust: minimum thrust, as a fraction of hover
            lateral_bias: torque added to a head-on nominal input, as a fraction of the largest
            shield: return only inputs after which a safe manoeuvre to rest is known
            room_m: distance beyond the radius that rows keep when shielded: they steer before the shield stops the vehicle [m]
            try_nominal: when the program has no solution, let the shield search between the backup and the nominal input
            smooth_nominal: The smooth nominal snap of cone-ecbf while rows hold the vehicle back, and until it is released.
            clf_weight: weight of the slack xi of the tracking row; 0: no tracking row
            clf_rate: decay rate c of the tracking row [1/s]
            clf_kp: position gain of the closed loop that defines V [1/s^2]
            clf_kv: velocity gain of the closed loop that defines V [1/s]
            shield_options: The check that a safe manoeuvre to rest remains after the returned input.
            pruning: Which ellipsoids become rows of the program in a tick: the distance gate v^2 / (2 a) + v t + radius, and what is within it.
        """

    @property
    def lambda_max(self) -> float:
        """
        limit to which the pole of a row is moved left when it starts beyond its safe set; at least lambda_ [1/s]
        """

    @property
    def return_time(self) -> float:
        """
        pole of a row with h < 0 times the time to its ellipsoid; the pole stays within lambda_ and lambda_max
        """

    @property
    def escape_rate(self) -> float:
        """pole of the rows on gamma [1/s]"""

    @property
    def min_speed_m_s(self) -> float:
        """speed below which the rows of all ellipsoids are on gamma [m/s]"""

    @property
    def cascade(self) -> str:
        """how the thrust enters the snap"""

    @property
    def thrust_bandwidth_rad_s(self) -> float:
        """
        bandwidth w with which the thrust follows its nominal value; w dt must be below 1 [rad/s]
        """

    @property
    def thrust_damping(self) -> float:
        """damping ratio zeta of the same"""

    @property
    def max_thrust_rate_n_s(self) -> float:
        """maximum |T'| [N/s]"""

    @property
    def least_thrust(self) -> float:
        """minimum thrust, as a fraction of hover"""

    @property
    def lateral_bias(self) -> float:
        """torque added to a head-on nominal input, as a fraction of the largest"""

    @property
    def shield(self) -> bool:
        """return only inputs after which a safe manoeuvre to rest is known"""

    @property
    def room_m(self) -> float:
        """
        distance beyond the radius that rows keep when shielded: they steer before the shield stops the vehicle [m]
        """

    @property
    def try_nominal(self) -> bool:
        """
        when the program has no solution, let the shield search between the backup and the nominal input
        """

    @property
    def smooth_nominal(self) -> SmoothNominalOptions:
        """
        The smooth nominal snap of cone-ecbf while rows hold the vehicle back, and until it is released.
        """

    @property
    def clf_weight(self) -> float:
        """weight of the slack xi of the tracking row; 0: no tracking row"""

    @property
    def clf_rate(self) -> float:
        """decay rate c of the tracking row [1/s]"""

    @property
    def clf_kp(self) -> float:
        """position gain of the closed loop that defines V [1/s^2]"""

    @property
    def clf_kv(self) -> float:
        """velocity gain of the closed loop that defines V [1/s]"""

    @property
    def shield_options(self) -> ShieldOptions:
        """
        The check that a safe manoeuvre to rest remains after the returned input.
        """

    @property
    def pruning(self) -> Pruning:
        """
        Which ellipsoids become rows of the program in a tick: the distance gate v^2 / (2 a) + v t + radius, and what is within it.
        """

class ConeEcbf(SafetyFilter):
    """The exponential collision cone filter of a quadrotor."""

    def __init__(self, policy: BackupPolicy, index: EllipsoidIndex, options: ConeEcbfOptions = ..., *, qp_backend: object | None = None, map: ObstacleMap | None = None, radius_m: float | None = None, near_map: ObstacleMap | None = None, near_radius_m: float | None = None) -> None:
        """
        qp_backend: as of QpSolver. map: what the shield certifies against, default the index; radius_m: the radius of its ball, default that of the index. near_map: obstacles around which rows steer, besides the index; near_radius_m: the radius for them, default that of the index.
        """

    @property
    def options(self) -> ConeEcbfOptions: ...

class ConeBackupOptions:
    """Options of the filter cone-backup."""

    def __init__(self, *, horizon_s: float = 1.5, nodes: int = 20, first_node: int = 1, steps: int = 0, alpha_running: float = 10.0, alpha_terminal: float = 5.0, min_speed_m_s: float = 0.1, far: float = float('inf'), solver: str = 'active-set', lateral_bias: float = 0.1, shield: bool = True, room_m: float = 0.08, try_nominal: bool = True, clf_weight: float = 0.0, clf_rate: float = 1.0, clf_kp: float = 3.0, clf_kv: float = 2.0, shield_options: ShieldOptions = ..., pruning: Pruning = ...) -> None:
        """
        Args:
            horizon_s: horizon of the backup flow [s]
            nodes: number of nodes N of the backup flow
            first_node: first node with running rows; 0: as printed
            steps: RK4 steps between nodes; 0: as few as keep them shorter than the time constant of the rates
            alpha_running: gain alpha_R of h' >= -alpha_R h at the nodes [1/s]
            alpha_terminal: gain alpha_T of gamma' >= -alpha_T gamma at the last node [1/s]
            min_speed_m_s: speed below which a node has no running rows [m/s]
            far: rows with h / beta beyond this are left out
            solver: solver of the program
            lateral_bias: torque added to a head-on nominal input, as a fraction of the largest
            shield: return only inputs after which a safe manoeuvre to rest is known
            room_m: distance beyond the radius that rows keep when shielded: they steer before the shield stops the vehicle [m]
            try_nominal: when the program has no solution, let the shield search between the backup and the nominal input
            clf_weight: weight of the slack xi of the tracking row; 0: no tracking row
            clf_rate: decay rate c of the tracking row [1/s]
            clf_kp: position gain of the closed loop that defines V [1/s^2]
            clf_kv: velocity gain of the closed loop that defines V [1/s]
            shield_options: The check that a safe manoeuvre to rest remains after the returned input.
            pruning: Which ellipsoids become rows of the program in a tick: the distance gate v^2 / (2 a) + v t + radius, and what is within it.
        """

    @property
    def horizon_s(self) -> float:
        """horizon of the backup flow [s]"""

    @property
    def nodes(self) -> int:
        """number of nodes N of the backup flow"""

    @property
    def first_node(self) -> int:
        """first node with running rows; 0: as printed"""

    @property
    def steps(self) -> int:
        """
        RK4 steps between nodes; 0: as few as keep them shorter than the time constant of the rates
        """

    @property
    def alpha_running(self) -> float:
        """gain alpha_R of h' >= -alpha_R h at the nodes [1/s]"""

    @property
    def alpha_terminal(self) -> float:
        """gain alpha_T of gamma' >= -alpha_T gamma at the last node [1/s]"""

    @property
    def min_speed_m_s(self) -> float:
        """speed below which a node has no running rows [m/s]"""

    @property
    def far(self) -> float:
        """rows with h / beta beyond this are left out"""

    @property
    def solver(self) -> str:
        """solver of the program"""

    @property
    def lateral_bias(self) -> float:
        """torque added to a head-on nominal input, as a fraction of the largest"""

    @property
    def shield(self) -> bool:
        """return only inputs after which a safe manoeuvre to rest is known"""

    @property
    def room_m(self) -> float:
        """
        distance beyond the radius that rows keep when shielded: they steer before the shield stops the vehicle [m]
        """

    @property
    def try_nominal(self) -> bool:
        """
        when the program has no solution, let the shield search between the backup and the nominal input
        """

    @property
    def clf_weight(self) -> float:
        """weight of the slack xi of the tracking row; 0: no tracking row"""

    @property
    def clf_rate(self) -> float:
        """decay rate c of the tracking row [1/s]"""

    @property
    def clf_kp(self) -> float:
        """position gain of the closed loop that defines V [1/s^2]"""

    @property
    def clf_kv(self) -> float:
        """velocity gain of the closed loop that defines V [1/s]"""

    @property
    def shield_options(self) -> ShieldOptions:
        """
        The check that a safe manoeuvre to rest remains after the returned input.
        """

    @property
    def pruning(self) -> Pruning:
        """
        Which ellipsoids become rows of the program in a tick: the distance gate v^2 / (2 a) + v t + radius, and what is within it.
        """

class ConeBackup(SafetyFilter):
    """The collision cone backup filter of a quadrotor."""

    def __init__(self, policy: BackupPolicy, index: EllipsoidIndex, options: ConeBackupOptions = ..., *, qp_backend: object | None = None, map: ObstacleMap | None = None, radius_m: float | None = None, near_map: ObstacleMap | None = None, near_radius_m: float | None = None) -> None:
        """
        qp_backend: as of QpSolver. map: what the shield certifies against, default the index; radius_m: the radius of its ball, default that of the index. near_map: obstacles around which rows steer, besides the index; near_radius_m: the radius for them, default that of the index.
        """

    @property
    def options(self) -> ConeBackupOptions: ...

class ShieldFilterOptions:
    """Options of the filter shield."""

    def __init__(self, *, shield_options: ShieldOptions = ...) -> None:
        """
        Args:
            shield_options: The check that a safe manoeuvre to rest remains after the returned input.
        """

    @property
    def shield_options(self) -> ShieldOptions:
        """
        The check that a safe manoeuvre to rest remains after the returned input.
        """

class ShieldFilter(SafetyFilter):
    """The shield alone: the nominal wrench where it is safe."""

    def __init__(self, policy: BackupPolicy, map: ObstacleMap, radius_m: float, options: ShieldFilterOptions = ...) -> None: ...

    @property
    def options(self) -> ShieldFilterOptions: ...

def ecbf_pole(h: float, h1: float, h2: float, lambda_: float, most: float) -> float:
    """
    The smallest pole from lambda_ to most at which psi_1 and psi_2 are not negative; lambda_ when there is none.
    """

class TrackerOptions:
    """Options of the tracker; immutable."""

    def __init__(self, *, gate: float = 30.0, confirm_hits: int = 5, confirm_scans: int = 6, delete_misses: int = 5, coast_s: float = 3.0, field_margin: float = 2.0, acceleration_noise: float = 0.5, jerk_noise: float = 0.2, with_turn: bool = False, turn_noise: float = 0.1, transition: Sequence[float] = [0.992, 0.008, 0.015, 0.985], prior: Sequence[float] = [0.9, 0.1], turn_transition: Sequence[float] = [0.986, 0.01, 0.004, 0.01, 0.986, 0.004, 0.015, 0.015, 0.97], turn_prior: Sequence[float] = [0.9, 0.05, 0.05], start_variance: Sequence[float] = [4.0, 25.0, 25.0], cross_range_variance: float = 100.0, turn_variance: float = 0.1, mixing_variance: float = 3.0, mixes: bool = True, gates_models: bool = False, heavy_tails: bool = False, adapts_transition: bool = False, winner_takes_all: bool = False, jamming: bool = False) -> None:
        """
        Args:
            gate: maximum squared Mahalanobis distance of an association
            confirm_hits: hits that confirm a track
            confirm_scans: number of scans in which these hits must occur
            delete_misses: misses in a row that delete a track
            coast_s: time without a detection, out of the field of view, that deletes a confirmed track [s]
            field_margin: standard deviations of a position that the field of view must contain
            acceleration_noise: spectral density of the white acceleration [m^2/s^3]
            jerk_noise: spectral density of the white jerk [m^2/s^5]
            with_turn: use the model of a coordinated turn
            turn_noise: spectral density of the turn rate's derivative [rad^2/s^3]
            transition: transition probabilities per scan, of constant velocity and acceleration
            prior: prior probabilities of these models
            turn_transition: transition probabilities per scan, of these models and the turn
            turn_prior: prior probabilities of these three models
            start_variance: initial variances of position, velocity and acceleration per axis
            cross_range_variance: variance of the initial velocity across the line of sight [m^2/s^2]
            turn_variance: variance of the turn rate, initially and in models without it [rad^2/s^2]
            mixing_variance: variance of the acceleration in models without it, when models mix [m^2/s^4]
            mixes: models restart from mixtures in each scan
            gates_models: SAFE-IMM
            heavy_tails: SAFE-IMM
            adapts_transition: SAFE-IMM
            winner_takes_all: SAFE-IMM
            jamming: SAFE-IMM
        """

    @property
    def gate(self) -> float:
        """maximum squared Mahalanobis distance of an association"""

    @property
    def confirm_hits(self) -> int:
        """hits that confirm a track"""

    @property
    def confirm_scans(self) -> int:
        """number of scans in which these hits must occur"""

    @property
    def delete_misses(self) -> int:
        """misses in a row that delete a track"""

    @property
    def coast_s(self) -> float:
        """
        time without a detection, out of the field of view, that deletes a confirmed track [s]
        """

    @property
    def field_margin(self) -> float:
        """standard deviations of a position that the field of view must contain"""

    @property
    def acceleration_noise(self) -> float:
        """spectral density of the white acceleration [m^2/s^3]"""

    @property
    def jerk_noise(self) -> float:
        """spectral density of the white jerk [m^2/s^5]"""

    @property
    def with_turn(self) -> bool:
        """use the model of a coordinated turn"""

    @property
    def turn_noise(self) -> float:
        """spectral density of the turn rate's derivative [rad^2/s^3]"""

    @property
    def transition(self) -> list[float]:
        """
        transition probabilities per scan, of constant velocity and acceleration
        """

    @property
    def prior(self) -> list[float]:
        """prior probabilities of these models"""

    @property
    def turn_transition(self) -> list[float]:
        """transition probabilities per scan, of these models and the turn"""

    @property
    def turn_prior(self) -> list[float]:
        """prior probabilities of these three models"""

    @property
    def start_variance(self) -> list[float]:
        """initial variances of position, velocity and acceleration per axis"""

    @property
    def cross_range_variance(self) -> float:
        """variance of the initial velocity across the line of sight [m^2/s^2]"""

    @property
    def turn_variance(self) -> float:
        """
        variance of the turn rate, initially and in models without it [rad^2/s^2]
        """

    @property
    def mixing_variance(self) -> float:
        """
        variance of the acceleration in models without it, when models mix [m^2/s^4]
        """

    @property
    def mixes(self) -> bool:
        """models restart from mixtures in each scan"""

    @property
    def gates_models(self) -> bool:
        """SAFE-IMM"""

    @property
    def heavy_tails(self) -> bool:
        """SAFE-IMM"""

    @property
    def adapts_transition(self) -> bool:
        """SAFE-IMM"""

    @property
    def winner_takes_all(self) -> bool:
        """SAFE-IMM"""

    @property
    def jamming(self) -> bool:
        """SAFE-IMM"""

class Tracker:
    """
    Tracks of moving obstacles: nearest neighbours and interacting multiple models.
    """

    def __init__(self, options: TrackerOptions = ..., most: int = 128) -> None:
        """
        Create a tracker with at most `most` tracks at a time. ValueError for invalid options.
        """

    def reset(self) -> None:
        """Delete all tracks."""

    def update(self, t: float, position: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], covariance: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], los: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)] | None = None, range_rate: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)] | None = None, range_rate_sigma: float = 0.1, field: FieldOfView | None = None) -> None:
        """
        Process one scan at t [s]: positions (N, 3) [m] with covariances (N, 3, 3), world frame; optionally the rates (N,) [m/s] along the lines of sight (N, 3) from the sensor. Rows that are not finite or have no covariance are dropped and counted. A confirmed track outside the field coasts. ValueError unless t is within 1e6 s after the last scan.
        """

    def tracks(self, t: float) -> dict[str, Any]:
        """
        All tracks predicted to t [s], oldest first: id, is_confirmed, p, v, a (N, 3), covariance of (p, v) (N, 6, 6), turning (N,): the probability of the models that accelerate or turn.
        """

    @property
    def dropped(self) -> int:
        """Number of detections dropped since the start."""

def assign(cost: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], gate: float = float('inf')) -> NDArray[numpy.int32]:
    """
    Assign to each row of the costs a column or -1 at minimum cost: a row without a column costs `gate`, costs above it or not finite are forbidden; without a gate as many rows as possible get one.
    """

class ObstacleSpec:
    """
    Moving obstacle, drawn for each trial: alula/flight/obstacle_motion.hpp. Pairs are ranges.
    """

    def __init__(self, *, kind: str = 'constant-velocity', radius_m: float = 0.15, is_relative: bool = True, position: Sequence[float] = [0.0, 0.0, 0.0], distance_m: float = 50.0, azimuth_rad: Sequence[float] = [0.0, 0.0], elevation_rad: Sequence[float] = [0.0, 0.0], either_side: bool = False, crosses: bool = False, offset_sigma_m: Sequence[float] = [0.0, 0.0, 0.0], speed_m_s: Sequence[float] = [5.0, 8.0], heading_rad: Sequence[float] = [0.0, 0.0], acceleration_m_s2: Sequence[float] = [0.0, 0.0], velocity_m_s: Sequence[float] = [0.0, 0.0, 0.0], aims_at_vehicle: bool = False, meeting_sigma_m: Sequence[float] = [0.0, 0.0, 0.0], max_speed_m_s: float = 12.0, turn_rate_rad_s: float = 0.25, release_m: float = 12.0, drag_per_m: float = 0.0, start_s: float = 0.0, way_points: Sequence[Sequence[float]] = [], body: Quadrotor | None = None, gains: TrackingGains | None = None) -> None:
        """
        Args:
            kind: motion: constant-velocity, accelerating, curving, ballistic or quadrotor
            radius_m: radius [m]
            is_relative: placed by distance and azimuth; false: at a position
            position: start [m]
            distance_m: distance from the vehicle's start [m]
            azimuth_rad: from the course [rad]
            elevation_rad: above the horizon [rad]
            either_side: draw the sign of the azimuth
            crosses: azimuth and elevation are seen from the meeting point
            offset_sigma_m: standard deviation of the start, frame (course, left, up) [m]
            speed_m_s: speed [m/s]
            heading_rad: from the direction to the meeting point, outwards [rad]
            acceleration_m_s2: acceleration, or limit of a leg [m/s^2]
            velocity_m_s: initial velocity; 0: from speed and heading [m/s]
            aims_at_vehicle: aim at the vehicle's start
            meeting_sigma_m: standard deviation of the meeting point [m]
            max_speed_m_s: maximum speed [m/s]
            turn_rate_rad_s: maximum turn rate [rad/s]
            release_m: distance below which it stops turning [m]
            drag_per_m: quadratic drag of a ballistic obstacle [1/m]
            start_s: time at which it starts to move [s]
            way_points: way-points of a quadrotor [m]
            body: body of a quadrotor, with its gains; default: a small one
            gains: gains of its controller
        """

    @property
    def kind(self) -> str: ...

    @property
    def radius_m(self) -> float: ...

    @property
    def start_s(self) -> float: ...

def obstacle_paths(spec: ObstacleSpec, vehicle: Annotated[NDArray[numpy.float64], dict(shape=(None, 9), order='C', device='cpu', writable=False)], *, dt_s: float, seed: int = 0, first_trial: int = 0, trials: int = 1, obstacle: int = 0) -> NDArray[numpy.float64]:
    """
    States of an obstacle beside a vehicle with states (p, v, a) (N, 9) at k dt, for each trial, shape (trials, N, 9).
    """

def meeting_time(r: Sequence[float], v: Sequence[float], s: float) -> float:
    """
    The smallest t with |r + v t| = s t; without one, the time of the nearest approach.
    """

class RadarOptions:
    """Obstacle sensor: alula/tracking/radar.hpp."""

    def __init__(self, *, kind: str = 'radar', rate_hz: float = 20.0, half_azimuth_rad: float = 0.6981317007977318, half_elevation_rad: float = 0.17453292519943295, max_range_m: float = 150.0, detection_probability: float = 0.95, sigma_range_m: float = 0.15, sigma_azimuth_rad: float = 0.008726646259971648, sigma_elevation_rad: float = 0.012217304763960306, sigma_range_rate_m_s: float = 0.1, clutter_per_scan: float = 0.1, clutter_range_rate_m_s: float = 15.0, noise_scale: float = 1.0, position_sigma_m: float = 0.0, delay_s: float = 0.0, own_position_sigma_m: float = 0.0, own_velocity_sigma_m_s: float = 0.0) -> None:
        """
        Args:
            kind: radar, ideal or mocap
            rate_hz: scans per second
            half_azimuth_rad: half width of the field of view [rad]
            half_elevation_rad: half height of the field of view [rad]
            max_range_m: range [m]
            detection_probability: probability of a detection
            sigma_range_m: noise of the range [m]
            sigma_azimuth_rad: noise of the azimuth [rad]
            sigma_elevation_rad: noise of the elevation [rad]
            sigma_range_rate_m_s: noise of the range rate [m/s]
            clutter_per_scan: mean number of false detections in a scan
            clutter_range_rate_m_s: their range rates are uniform within +- this [m/s]
            noise_scale: factor of all sigmas
            position_sigma_m: noise of ideal and mocap per axis [m]
            delay_s: time until the tracker receives a detection [s]
            own_position_sigma_m: noise of the vehicle's own position per axis [m]
            own_velocity_sigma_m_s: noise of the vehicle's own velocity per axis [m/s]
        """

    @property
    def kind(self) -> str:
        """radar, ideal or mocap"""

    @property
    def rate_hz(self) -> float:
        """scans per second"""

    @property
    def half_azimuth_rad(self) -> float:
        """half width of the field of view [rad]"""

    @property
    def half_elevation_rad(self) -> float:
        """half height of the field of view [rad]"""

    @property
    def max_range_m(self) -> float:
        """range [m]"""

    @property
    def detection_probability(self) -> float:
        """probability of a detection"""

    @property
    def sigma_range_m(self) -> float:
        """noise of the range [m]"""

    @property
    def sigma_azimuth_rad(self) -> float:
        """noise of the azimuth [rad]"""

    @property
    def sigma_elevation_rad(self) -> float:
        """noise of the elevation [rad]"""

    @property
    def sigma_range_rate_m_s(self) -> float:
        """noise of the range rate [m/s]"""

    @property
    def clutter_per_scan(self) -> float:
        """mean number of false detections in a scan"""

    @property
    def clutter_range_rate_m_s(self) -> float:
        """their range rates are uniform within +- this [m/s]"""

    @property
    def noise_scale(self) -> float:
        """factor of all sigmas"""

    @property
    def position_sigma_m(self) -> float:
        """noise of ideal and mocap per axis [m]"""

    @property
    def delay_s(self) -> float:
        """time until the tracker receives a detection [s]"""

    @property
    def own_position_sigma_m(self) -> float:
        """noise of the vehicle's own position per axis [m]"""

    @property
    def own_velocity_sigma_m_s(self) -> float:
        """noise of the vehicle's own velocity per axis [m/s]"""

class FieldOfView:
    """Field of view of a scan."""

    def __init__(self, *, position: Sequence[float], yaw: float = 0.0, half_azimuth_rad: float = 0.6981317007977318, half_elevation_rad: float = 0.17453292519943295, max_range_m: float = 150.0) -> None:
        """
        Args:
            position: position of the sensor [m]
            yaw: heading, levelled [rad]
            half_azimuth_rad: half width [rad]
            half_elevation_rad: half height [rad]
            max_range_m: range [m]
        """

    def holds(self, mean: Sequence[float], covariance: Sequence[Sequence[float]], margin: float) -> bool:
        """
        True if it contains all points within `margin` standard deviations of the range and of both angles.
        """

def radar_scans(options: RadarOptions, vehicle: Annotated[NDArray[numpy.float64], dict(shape=(None, 9), order='C', device='cpu', writable=False)], yaw: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], truth: Annotated[NDArray[numpy.float64], dict(shape=(None, None, 9), order='C', device='cpu', writable=False)], *, seed: int = 0, trial: int = 0, first_step: int = 0) -> dict[str, Any]:
    """
    Detections of scans at states (N, 9), headings (N,) and truths (N, obstacles, 9); `scan` is the number of the scan.
    """

def own_states(options: RadarOptions, vehicle: Annotated[NDArray[numpy.float64], dict(shape=(None, 9), order='C', device='cpu', writable=False)], *, seed: int = 0, trial: int = 0, first_step: int = 0) -> NDArray[numpy.float64]:
    """Measurements of its own state by a vehicle at states (N, 9)."""

class MovingSpec:
    """What moves around a vehicle, and how it senses that."""

    def __init__(self, *, obstacles: Sequence[ObstacleSpec] = [], radar: RadarOptions = ..., tracker: TrackerOptions = ..., yaw_rate_rad_s: float = 1.0) -> None:
        """
        yaw_rate_rad_s: maximum rate at which the sensor turns; 0: it looks along the course.
        """

def collision_risk(position: Sequence[float], velocity: Sequence[float], covariance: Sequence[float], command: Sequence[float], radius: float, window_s: float) -> float:
    """
    Collision risk of an obstacle relative to the vehicle, covariance of (p, v) as a lower triangle row by row: bound on the probability that it is within the radius when it comes closest in the window.
    """

def closest_approach(r0: Sequence[float], r1: Sequence[float], a: Sequence[float], h: float) -> float:
    """
    Minimum |r(t)|, 0 <= t <= h, of the parabola from r0 to r1 with acceleration a.
    """

class MovingReport:
    """Report of a filter among moving obstacles for one tick."""

    @property
    def status(self) -> int:
        """
        0 nominal command, 1 another command that satisfies all rows, 3 minimum violation of the rows, 4 refused.
        """

    @property
    def acceleration(self) -> list[float]:
        """
        Acceleration to fly [m/s^2]; zero when refused, and then it must not be flown.
        """

    @property
    def mode(self) -> int:
        """0 nominal, 1 avoid, 2 hover."""

    @property
    def warned(self) -> bool:
        """True when an obstacle triggers the warning in this tick."""

    @property
    def risk_m(self) -> float:
        """The largest CVaR; 0 or more warns."""

    @property
    def urgent(self) -> int:
        """Index of the most urgent track or -1."""

    @property
    def horizon_s(self) -> float:
        """Horizon of the rows [s]."""

    @property
    def feasible(self) -> bool:
        """Rows and box have a common point."""

    @property
    def rows(self) -> int:
        """Number of rows."""

    @property
    def iterations(self) -> int:
        """Iterations of the solver."""

    @property
    def violation(self) -> float:
        """Violation of the rows, minus infinity without rows."""

    @property
    def risk_left(self) -> float:
        """Sum over obstacles of Cantelli's bound at the command."""

class MovingFilter:
    """A filter among moving obstacles; make one with `moving_filter`."""

    def filter(self, position: Sequence[float], velocity: Sequence[float], tracks: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], walls: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)], nominal: Sequence[float], covariance: Sequence[float] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], repeats: int = 0) -> tuple[MovingReport, float]:
        """
        Filter one tick: the report, and the median time [s] of `repeats` copies of it. `tracks` (n, 29): id, position,
        velocity, lower triangle of their covariance row by row, radius. `walls` (m, 4): unit normal towards the
        vehicle, distance. `covariance` xx, xy, xz, yy, yz, zz of the vehicle's position.
        """

    def flown(self, acceleration: Sequence[float]) -> None:
        """Report the acceleration that is flown in a refused tick."""

    def reset(self) -> None:
        """Reset to the state before the first tick."""

    def clone(self) -> MovingFilter:
        """A copy with the same state."""

def moving_filter(method: str, options: Mapping[str, float] = {}, backend: object | None = None) -> MovingFilter:
    """
    Create none, dr_acbf, dr_acbf_qp, mpc, cbf_qp or rp_cbf; `options` override `moving_filter_defaults`; `backend`
    solves its quadratic programs, as in QpSolver. ValueError for invalid options.
    """

def moving_filter_defaults() -> dict[str, float]:
    """All options of `moving_filter` with their defaults."""

def half_space_projection(rows: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)], a0: Sequence[float], solver: str = 'exact', *, limit: float = 6.0, omega: float = 1.0, iterations: int = 15, soft: int = 4294967295, repeats: int = 1) -> tuple[list[float], bool, float, int, list[int], float]:
    """
    min |a - a0| with rows (n, b): n . a <= b and |a|_inf <= limit, by exact, gs or least-violation: (a, feasible,
    violation, iterations, basis, seconds).
    """

def half_space_projections(rows: Annotated[NDArray[numpy.float64], dict(shape=(None, None, 4), order='C', device='cpu', writable=False)], a0: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], limit: float = 6.0) -> tuple[NDArray[numpy.float32], NDArray[numpy.uint8], NDArray[numpy.float32], NDArray[numpy.uint32]]:
    """
    Exact projections of rows (k, n, 4): a (k, 3), feasible, violation and iterations (k).
    """

def early_warning(position: Sequence[float], velocity: Sequence[float], track: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], relative_acceleration: Sequence[float], covariance: Sequence[float] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], options: Mapping[str, float] = {}) -> float:
    """
    Maximum over five times of the CVaR of Z, rounded up, plus eps L_Z [m].
    """

def early_warning_tails(tail: float) -> tuple[float, float]:
    """CVaR of a standard normal variable and of its square, rounded up."""

def acceleration_envelope(velocity: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], options: Mapping[str, float] = {}) -> NDArray[numpy.float32]:
    """z1 and ahat (k, 4) after each of the velocities (k, 3)."""

def allocate_risk(distance: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], closing: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], total: float, receding: bool = False) -> NDArray[numpy.float32]:
    """
    Risks alpha_i of the obstacles; 0 for obstacles with closing <= 0 unless `receding`.
    """

def row_bound(distance: float, closing: float, horizon_s: float, lambda_: float, *, radius_m: float = 0.3, envelope: float = 1.0, sigma2_p: float = 0.0, sigma2_v: float = 0.0, options: Mapping[str, float] = {}) -> float:
    """b(H) of a row [m/s^2]."""

def cantelli(alpha: float) -> float:
    """sqrt((1 - alpha) / alpha)."""

def recursive_speed(a_max: float, horizon_s: float) -> float:
    """Closing speed below which the rows never demand more than a_max."""

class RacerModel:
    """
    A drone behind a rate loop: thrust a_0 + a_1 u + a_2 u^2 [m/s^2] of the throttle, and rates that follow their command with a gain [1/s].
    """

    def __init__(self, *, gravity: float = 9.81, thrust: Sequence[float] = [0.0, 7.75474, 73.895455], rate_gain: float = 50.0, max_rate: Sequence[float] = [12.0, 12.0, 6.0]) -> None:
        """
        Args:
            gravity: gravity [m/s^2]
            thrust: a_0, a_1, a_2 of the thrust map [m/s^2]
            rate_gain: gain of the rate loop [1/s]
            max_rate: maximum rates of a command [rad/s]
        """

    @property
    def gravity(self) -> float:
        """gravity [m/s^2]"""

    @property
    def thrust(self) -> list[float]:
        """a_0, a_1, a_2 of the thrust map [m/s^2]"""

    @property
    def rate_gain(self) -> float:
        """gain of the rate loop [1/s]"""

    @property
    def max_rate(self) -> list[float]:
        """maximum rates of a command [rad/s]"""

    def throttle_for(self, acceleration: float) -> float:
        """The throttle for an acceleration [m/s^2], in [0, 1]."""

class RacerOptions:
    """
    Disturbances of a racing drone's plant that its model omits; all off by default.
    """

    def __init__(self, *, mass: float = 1.0, mass_scale: float = 1.0, thrust_scale: float = 1.0, rate_gain_scale: float = 1.0, delay_s: float = 0.0, linear_drag: Sequence[float] = [0.0, 0.0, 0.0], quadratic_drag: Sequence[float] = [0.0, 0.0, 0.0], wind_m_s: Sequence[float] = [0.0, 0.0, 0.0], gust_m_s: Sequence[float] = [0.0, 0.0, 0.0], gust_time_s: float = 1.0, sag_share: float = 0.0, sag_time_s: float = 0.5) -> None:
        """
        Args:
            mass: mass, used only for the drag [kg]
            mass_scale: ratio of true to assumed mass
            thrust_scale: ratio of true to assumed thrust
            rate_gain_scale: ratio of true to assumed gain of the rate loop
            delay_s: time from a command until it acts [s]
            linear_drag: linear drag along the body axes [N s/m]
            quadratic_drag: quadratic drag along the body axes [N s^2/m^2]
            wind_m_s: mean wind [m/s]
            gust_m_s: standard deviation of gusts per axis [m/s]
            gust_time_s: time constant of gusts [s]
            sag_share: fraction of the thrust that is lost at full throttle
            sag_time_s: time constant of that loss [s]
        """

    @property
    def mass(self) -> float:
        """mass, used only for the drag [kg]"""

    @property
    def mass_scale(self) -> float:
        """ratio of true to assumed mass"""

    @property
    def thrust_scale(self) -> float:
        """ratio of true to assumed thrust"""

    @property
    def rate_gain_scale(self) -> float:
        """ratio of true to assumed gain of the rate loop"""

    @property
    def delay_s(self) -> float:
        """time from a command until it acts [s]"""

    @property
    def linear_drag(self) -> list[float]:
        """linear drag along the body axes [N s/m]"""

    @property
    def quadratic_drag(self) -> list[float]:
        """quadratic drag along the body axes [N s^2/m^2]"""

    @property
    def wind_m_s(self) -> list[float]:
        """mean wind [m/s]"""

    @property
    def gust_m_s(self) -> list[float]:
        """standard deviation of gusts per axis [m/s]"""

    @property
    def gust_time_s(self) -> float:
        """time constant of gusts [s]"""

    @property
    def sag_share(self) -> float:
        """fraction of the thrust that is lost at full throttle"""

    @property
    def sag_time_s(self) -> float:
        """time constant of that loss [s]"""

class Racer:
    """A flight of a racing drone; a function of commands, seed and trial."""

    def __init__(self, model: RacerModel, options: RacerOptions = ..., *, seed: int = 0, trial: int = 0) -> None: ...

    def reset(self, x: Annotated[NDArray[numpy.float64], dict(shape=(13), order='C', device='cpu', writable=False)]) -> None:
        """Reset to a state (13): p, v, q wxyz, omega."""

    def step(self, dt: float, u: Annotated[NDArray[numpy.float64], dict(shape=(4), order='C', device='cpu', writable=False)]) -> None:
        """Advance by dt with a command (4): throttle, rates."""

    @property
    def state(self) -> NDArray[numpy.float64]: ...

    @property
    def time(self) -> float: ...

class Fence:
    """
    Allowed region: in a box, in a polytope, outside the hulls of an onboard map.
    """

    def __init__(self, *, box: tuple[Sequence[float], Sequence[float]] | None = None, faces: Annotated[NDArray[numpy.float64], dict(shape=(None, 4), order='C', device='cpu', writable=False)] | None = None, image: bytes | None = None, keep_out: PolytopeSet | None = None) -> None:
        """
        `box` (lower, upper); `faces` (L, 4), rows n, d with n . p <= d inside and |n| = 1; `image` of an onboard map for the filter, `keep_out` the same polytopes for judging flights.
        """

    def clearance(self, a: Sequence[float], b: Sequence[float]) -> float:
        """
        Minimum distance of a segment from the forbidden region; negative inside it.
        """

    def braking_distance(self, deciding: int, p: Sequence[float], v: Sequence[float]) -> float:
        """
        Distance of a point from the constraint that decides a filter's result; where no face and no map decides, from the face that a straight flight with this velocity meets first.
        """

class Geofence:
    """
    The onboard geofence: an implicit control barrier function by simulating the backup controller.

    Parameters by name, see alula_geofence_config; ValueError for those it does not accept.
    """

    def __init__(self, fence: Fence, model: RacerModel = ..., parameters: Mapping[str, float] = {}) -> None: ...

    @staticmethod
    def conditions(model: RacerModel = ..., parameters: Mapping[str, float] = {}) -> dict[str, float]:
        """
        Conditions of the guarantee, see alula_geofence_conditions, also where they do not hold.
        """

    @property
    def hover_throttle(self) -> float: ...

    @property
    def config_words(self) -> bytes:
        """The bytes of its alula_geofence_config."""

    @property
    def fence_words(self) -> bytes:
        """
        The bytes of its alula_fence: has_box, lower (3), upper (3), face_count, and the faces (4 each).
        """

    @property
    def parameters(self) -> dict[str, float]:
        """All of them by name, as the filter holds them: in single precision."""

    def reset(self) -> None:
        """Reset to the state before the first tick."""

    def filter(self, navigation: NDArray[numpy.float64] | None, pilot: NDArray[numpy.float64] | None) -> tuple[NDArray[numpy.float64], str, dict[str, float]]:
        """
        One tick: command (4), status and details. None: no navigation, or no pilot.
        """

    def evaluate(self, states: NDArray[numpy.float64]) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64]]:
        """
        Flows that begin at states (N, 13): (h_I, min h_c / v_c, margin, distance, h_B) (N, 5), and u_B (N, 4).
        """

class BackupQp:
    """
    The backup-set barrier with gradients, by a quadratic program, with the flow of a Geofence.
    """

    def __init__(self, geofence: Geofence, alpha: float = 2.0) -> None: ...

    @property
    def alpha(self) -> float:
        """Gain [1/s]."""

    def reset(self) -> None:
        """Reset to the state before the first tick."""

    def filter(self, states: NDArray[numpy.float64], pilots: NDArray[numpy.float64]) -> tuple[NDArray[numpy.float64], NDArray[numpy.float64], NDArray[numpy.int64], NDArray[numpy.uint8]]:
        """
        Ticks at states (N, 13) with pilots (N, 4): commands (N, 4), h_I, rows of the program, and whether it had no solution.
        """

class Pilot:
    """A simulated pilot."""

    def __init__(self, kind: str, *, heading_rad: float = 0.0, tilt_rad: float = 1.2566, climb_m_s2: float = 0.0, silent_after_s: float = 1.5) -> None:
        """
        straight, diagonal, fall, sticks, aggressive, silent or repeated; ValueError for others.

        Args:
            heading_rad: heading of straight and repeated; diagonal is 45 degrees to the left [rad]
            tilt_rad: commanded tilt [rad]
            climb_m_s2: commanded vertical acceleration of diagonal [m/s^2]
            silent_after_s: minimum time until silent stops transmitting; the maximum is twice that [s]
        """

class PilotHand:
    """A pilot in one flight, as simulated flights have him."""

    def __init__(self, pilot: Pilot, model: RacerModel, start_height: float, *, seed: int = 0, trial: int = 0) -> None: ...

    def command(self, time: float, x: NDArray[numpy.float64]) -> NDArray[numpy.float64] | None:
        """His command (4) at a state (13); None: no radio."""

def safe_racer_start(geofence: Geofence, box: tuple[Sequence[float], Sequence[float]], *, speed_m_s: float = 10.0, tilt_rad: float = 1.0, seed: int = 0, trial: int = 0, others: ObstacleMap | None = None) -> NDArray[numpy.float64]:
    """
    Random start (13) in a box (lower, upper) with h_I > 0 and clear of other obstacles, at most so fast [m/s] and
    tilted [rad].
    """

class OnboardStackResult:
    """Report of the stack of onboard filters for one tick."""

    @property
    def status(self) -> int:
        """0 nominal, 1 filtered, 2 shortened, 3 recovering, 4 refused."""

    @property
    def velocity(self) -> NDArray[numpy.float64]:
        """Velocity (3) [m/s]."""

    @property
    def margin_m(self) -> float:
        """Minimum of D - r over hulls and faces [m]."""

    @property
    def mode(self) -> int:
        """0 nominal, 1 avoid, 2 hover, of dr-acbf."""

    @property
    def horizon_s(self) -> float:
        """Horizon of the obstacles' rows [s]."""

    @property
    def violation_m_s(self) -> float:
        """
        Largest violation of an obstacle's row [m/s]; a huge negative number without one.
        """

    @property
    def rows(self) -> int:
        """Number of rows."""

    @property
    def obstacle_rows(self) -> int:
        """Of them, those of obstacles."""

    @property
    def failing(self) -> int:
        """Ticks in a row whose rows did not hold."""

class OnboardStack:
    """
    The onboard filter among hulls and moving obstacles, in a fence, of a vehicle that follows velocities with a
    lag: alula_stack.h. ValueError for a combination that it refuses.
    """

    def __init__(self, image: bytes, polytope_cbf: PolytopeCbfConfig, lag_s: float = 0.35, extent_m: float = 0.0, *, dr_acbf: Mapping[str, float] = {}, fence: Fence | None = None) -> None: ...

    def reset(self) -> None:
        """Reset to the state before the first tick."""

    def filter(self, x: Sequence[float], v: Sequence[float], u_nom: Sequence[float], tracks: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], *, covariance: Sequence[float] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], is_taking_off: bool = False) -> OnboardStackResult:
        """
        Filter one tick: position, velocity, nominal velocity (3), tracks (n, 29) as of MovingFilter, covariance of the
        position.
        """

    def rows(self, result: OnboardStackResult) -> NDArray[numpy.float64]:
        """
        Rows (n, 5) of the last tick: unit normal and bound of normal . u <= bound; 0 of an obstacle, 1 of a hull or face, 2 of
        one whose margin the chord has entered.
        """

    def work(self) -> list[int]:
        """
        Of the last call: boxes, hulls, values of planes, decoded planes, rows, those inside margins.
        """

    @property
    def fence_words(self) -> bytes:
        """The bytes of its alula_fence, as those of a geofence."""

class PendulumFilter:
    """
    A safety filter of the inverted pendulum theta'' = sin theta + u: `regulation` or `backup-qp`.
    """

    def __init__(self, rule: str, *, largest_angle: float = 1.0, end_rate: float = 0.1, k: float = 3.0, push_distance: float = 0.1, push_gain: float = 1.0, push_rate: float = 0.1, horizon_s: float = 3.0, steps: int = 100, beta: float = 15.0, alpha: float = 5.0, largest_input: float = 20.0) -> None:
        """
        Args:
            largest_angle: theta_max [rad]
            end_rate: rate at the end of the flow [rad/s]
            k: gain of the backup controller [1/s]
            push_distance: distance from the limit within which the backup controller moves away [rad]
            push_gain: gain of that motion [1/s]
            push_rate: maximum rate of that motion [rad/s]
            horizon_s: horizon of the flow [s]
            steps: steps of the flow
            beta: gain of the regulation
            alpha: gain of the QP [1/s]
            largest_input: maximum input of the QP and of u_des
        """

    def filter(self, states: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='C', device='cpu', writable=False)], u_des: float) -> NDArray[numpy.float64]:
        """Filter at states (N, 2): u, h_I, lambda, rows, infeasible (N, 5)."""

    def fly(self, angle: float, rate: float, u_des: float, dt: float, ticks: int) -> NDArray[numpy.float64]:
        """
        Fly the closed loop: theta, theta', u, h_I, lambda, rows, infeasible (ticks, 7).
        """

class Rates:
    """
    A flight controller's rate profile (rates_type BETAFLIGHT) as the onboard code maps it, in single precision; axes are roll, pitch, yaw.
    """

    def __init__(self, *, rc_rate: Sequence[float] = [1.0, 1.0, 1.0], super_rate: Sequence[float] = [0.7, 0.7, 0.7], expo: Sequence[float] = [0.0, 0.0, 0.0], middle_us: float = 1500.0, throttle_low_us: float = 1050.0, throttle_high_us: float = 2000.0) -> None:
        """Create a profile; ValueError for numbers out of range."""

    def rate(self, axis: int, deflection: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float32]:
        """Rates [rad/s] of deflections (N)."""

    def deflection(self, axis: int, rate: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> NDArray[numpy.float32]:
        """Deflections of rates (N) [rad/s]."""

    def channels(self, commands: NDArray[numpy.float64]) -> tuple[NDArray[numpy.uint16], NDArray[numpy.uint8]]:
        """
        Pulses (N, 4) [us] of roll, pitch, throttle, yaw for commands (N, 4): throttle, rates; and which commands are refused.
        """

    def commands(self, channels: NDArray[numpy.uint16]) -> tuple[NDArray[numpy.float64], NDArray[numpy.uint8]]:
        """Commands (N, 4) for pulses (N, 4), and which pulses are refused."""

def draw_picture(rotation: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C', device='cpu', writable=False)], centre: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C', device='cpu', writable=False)], focal: float, columns: int, rows: int, near: float, is_parallel: bool, mean: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], covariance: Annotated[NDArray[numpy.float32], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], color: Annotated[NDArray[numpy.uint8], dict(shape=(None, 3), order='C', device='cpu', writable=False)], opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], corner: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3), order='C', device='cpu', writable=False)], corner_color: Annotated[NDArray[numpy.uint8], dict(shape=(None, 3), order='C', device='cpu', writable=False)], corner_opacity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], end: Annotated[NDArray[numpy.float64], dict(shape=(None, 2, 3), order='C', device='cpu', writable=False)], end_color: Annotated[NDArray[numpy.uint8], dict(shape=(None, 3), order='C', device='cpu', writable=False)], style: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], line: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], jobs: int = 0, progress: object | None = None) -> tuple[NDArray[numpy.float32], NDArray[numpy.float32], NDArray[numpy.float32]]:
    """
    Draw Gaussians, triangles and segments of lines: (colour f32 (rows, columns, 3), 0 to 255, without what is
    behind; fraction of the background that is seen f32 (rows, columns); depth f32 (rows, columns) where half of
    the light is stopped, infinite where it is not). The camera has x right, y down, z forward: x = rotation
    (world - centre), pixel = middle + focal (x, y) / z [px], or with `is_parallel` middle + focal (x, y) [px/m].
    Gaussians: `mean` (N, 3), `covariance` (N, 3, 3), `color` (N, 3), `opacity` (N,). Triangles: `corner` (T, 3, 3),
    `corner_color` (T, 3), `corner_opacity` (T,). Segments: `end` (L, 2, 3), `end_color` (L, 3), `style` (L, 3):
    width [px], opacity, and the opacity with which it shows through what hides it; `line` (L,): segments with the
    same number overlap without getting darker. World frame, metres. Values that are not finite are skipped. The
    result does not depend on `jobs`.
    """

class VelocityFilter(SafetyFilter):
    """polytope-cbf as a safety filter of velocities."""

    def __init__(self, filter: PolytopeCbf, *, is_bare: bool = False) -> None:
        """is_bare: only report the margin, and pass the nominal velocity."""

class ChordFilter(SafetyFilter):
    """A filter of velocities on the chord of a vehicle that lags."""

    def __init__(self, filter: SafetyFilter, *, lag_s: float | Sequence[float], max_speed_m_s: float) -> None:
        """lag_s: of all axes, or of each."""

class MovingSafety(SafetyFilter):
    """A filter among moving obstacles, with walls of a map."""

    def __init__(self, filter: MovingFilter, walls: ObstacleMap | None = None, *, max_speed_m_s: float, max_acceleration_m_s2: float, radius_m: float) -> None:
        """walls: static obstacles, or None."""

class FenceFilter(SafetyFilter):
    """The geofence, or with alpha the filter backup-qp."""

    def __init__(self, geofence: Geofence, alpha: float | None = None, *, is_bare: bool = False) -> None:
        """is_bare: pass the pilot's command."""

class PythonFilter(SafetyFilter):
    """A filter in Python; flights run in one thread."""

    def __init__(self, kind: object, made: object) -> None:
        """made: has tick(state, nominal) -> dict and reset()."""

class FollowingOptions:
    """
    How an autopilot follows velocities and accelerations: alula/flight/autopilot.hpp.
    """

    def __init__(self, *, horizontal_acceleration_m_s2: float = 0.0, horizontal_jerk_m_s3: float = 0.0, vertical_acceleration_m_s2: float = 0.0, vertical_jerk_m_s3: float = 0.0, lag_s: float = 0.1, position_gain_per_s: float = 1.0, velocity_gain_per_s: float = 2.0, climb_gain_per_s: float = 5.0) -> None:
        """
        Args:
            horizontal_acceleration_m_s2: limit; 0: not shaped [m/s^2]
            horizontal_jerk_m_s3: limit of its change [m/s^3]
            vertical_acceleration_m_s2: the same, vertically [m/s^2]
            vertical_jerk_m_s3: limit of its change [m/s^3]
            lag_s: of the acceleration within the attitude loop [s]
            position_gain_per_s: velocity by the error of the shaped position [1/s]
            velocity_gain_per_s: acceleration by that of the velocity [1/s]
            climb_gain_per_s: the same, vertically [1/s]
        """

    @property
    def horizontal_acceleration_m_s2(self) -> float:
        """limit; 0: not shaped [m/s^2]"""

    @property
    def horizontal_jerk_m_s3(self) -> float:
        """limit of its change [m/s^3]"""

    @property
    def vertical_acceleration_m_s2(self) -> float:
        """the same, vertically [m/s^2]"""

    @property
    def vertical_jerk_m_s3(self) -> float:
        """limit of its change [m/s^3]"""

    @property
    def lag_s(self) -> float:
        """of the acceleration within the attitude loop [s]"""

    @property
    def position_gain_per_s(self) -> float:
        """velocity by the error of the shaped position [1/s]"""

    @property
    def velocity_gain_per_s(self) -> float:
        """acceleration by that of the velocity [1/s]"""

    @property
    def climb_gain_per_s(self) -> float:
        """the same, vertically [1/s]"""

class Autopilot:
    """The motion into which an autopilot shapes set-points."""

    def __init__(self, options: FollowingOptions) -> None: ...

    def reset(self, state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)]) -> None:
        """Begin from a motion; a climb is being braked."""

    def follow_velocity(self, dt_s: float, velocity: Sequence[float], state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)]) -> list[float]:
        """A step; the acceleration that the attitude loop gets [m/s^2]."""

    def follow_acceleration(self, dt_s: float, acceleration: Sequence[float], state: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)]) -> list[float]: ...

    @property
    def velocity(self) -> list[float]: ...

    @property
    def acceleration(self) -> list[float]: ...

class PlanClockOptions:
    """How time along a plan waits: alula/flight/plan_clock.hpp."""

    def __init__(self, *, near_m: float = 0.3, far_m: float = 1.0, slew_per_s: float = 2.0, via_s: Sequence[float] = ..., via_m: float = float('inf'), own_via_m: Sequence[float] = ...) -> None:
        """
        Args:
            near_m: error up to which the time runs at full rate [m]
            far_m: error from which on it stands still [m]
            slew_per_s: maximum change of the rate [1/s]
            via_s: times of the via points along the plan, ascending [s]
            via_m: distance within which a via point counts as passed [m]
            own_via_m: the same of each via point, where they differ [m]
        """

    @property
    def near_m(self) -> float:
        """error up to which the time runs at full rate [m]"""

    @property
    def far_m(self) -> float:
        """error from which on it stands still [m]"""

    @property
    def slew_per_s(self) -> float:
        """maximum change of the rate [1/s]"""

    @property
    def via_s(self) -> list[float]:
        """times of the via points along the plan, ascending [s]"""

    @property
    def via_m(self) -> float:
        """distance within which a via point counts as passed [m]"""

    @property
    def own_via_m(self) -> list[float]:
        """the same of each via point, where they differ [m]"""

class PlanClock:
    """Time along a plan, which slows down for a vehicle that falls behind."""

    def __init__(self, curve: ReferenceCurve, options: PlanClockOptions = ...) -> None: ...

    def pause(self, heading_rad: float) -> None: ...

    def enter(self, time_s: float, rate: float, heading_rad: float) -> None: ...

    def advance(self, dt_s: float, error_m: float) -> None: ...

    def target(self) -> NDArray[numpy.float64]:
        """A row of `ReferenceCurve.at`, shape (1, 18), by the slowed time."""

    @property
    def time_s(self) -> float: ...

    @property
    def rate(self) -> float: ...

    @property
    def is_over(self) -> bool: ...

class VehicleSpec:
    """A vehicle, as modelled and as it truly is."""

    def __init__(self, body: Quadrotor, *, model: str = 'quadrotor', interface: str = 'wrench', gains: TrackingGains = ..., plant: PlantOptions = ..., assumed: ActuatorModel = ..., max_rate_rad_s: Sequence[float] = [10.0, 10.0, 4.0], rate_time_constant_s: Sequence[float] = [0.02, 0.02, 0.02], velocity_gain_per_s: float = 2.0, following: FollowingOptions = ..., velocity_lag_s: float | Sequence[float] = [0.0, 0.0, 0.0], max_speed_m_s: float = float('inf'), max_acceleration_m_s2: float = float('inf'), max_jerk_m_s3: float = float('inf'), actuation_delay_s: float = 0.0, radius_m: float = 0.0, racer: RacerModel = ..., racer_options: RacerOptions = ..., mass_scale: float = 1.0, rate_gain_scale: float = 1.0) -> None:
        """
        Args:
            model: single-integrator, double-integrator, quadrotor or racer
            interface: velocity, acceleration, wrench, body-rates or sticks
            gains: gains of the tracking controller
            plant: true lag, air, noise and delay
            assumed: lag and delay that controller and filters assume
            max_rate_rad_s: limit of a commanded body rate [rad/s]
            rate_time_constant_s: of each axis of the vehicle's own rate loop [s]
            velocity_gain_per_s: of the velocity loop [1/s]
            following: how the autopilot shapes velocities and accelerations
            velocity_lag_s: assumed time constant with which velocities are followed, of all axes or of each [s]
            max_speed_m_s: limit of velocity commands, and of points [m/s]
            max_acceleration_m_s2: limit of points [m/s^2]
            max_jerk_m_s3: limit of a double integrator [m/s^3]
            actuation_delay_s: of a double integrator [s]
            radius_m: of the sphere [m]
            racer: thrust by throttle, for sticks
            racer_options: what the true racer has and its model lacks
            mass_scale: true mass over that of the body
            rate_gain_scale: true gain of the rate loop over that of the model
        """

class FlightOptions:
    """Timing of a flight on board."""

    def __init__(self, *, dt_s: float = 0.01, controller_ticks: int = 1, filter_ticks: int = 1, stale_s: float = 0.5, has_losses: bool = False, disturbance_time_s: float = 0.0, disturbance_max_m_s2: float = 4.0, disturbance_max_interval_s: float = 0.3, response_time_s: float = 0.0, response_room_m_s2: float = 0.3, response_delay_s: float = 0.3, response_shortest_lag_s: float = 0.1, response_jerk_m_s3: float = 4.0, response_release_s: float = 1.0, response_max_m_s2: float = 4.0, response_max_interval_s: float = 0.3) -> None:
        """
        Args:
            dt_s: a tick [s]
            controller_ticks: ticks for which the nominal command is held
            filter_ticks: ticks for which the filters' command is held
            stale_s: a measurement older than this is not predicted any more [s]
            has_losses: measurements can be missing
            disturbance_time_s: time constant of the estimate of disturbances; 0: none [s]
            disturbance_max_m_s2: maximum length of the estimate [m/s^2]
            disturbance_max_interval_s: after a longer time without a measurement the estimate goes on from the next one [s]
            response_time_s: time constant of the estimate of what a vehicle's response leaves out; 0: none [s]
            response_room_m_s2: by which the interval of expected accelerations is wider on both sides [m/s^2]
            response_delay_s: a command of this age may be the one that is followed [s]
            response_shortest_lag_s: shortest lag of a vehicle that follows velocities [s]
            response_jerk_m_s3: with which accelerations are followed at least [m/s^3]
            response_release_s: time constant with which the bound decays [s]
            response_max_m_s2: maximum length of the estimate [m/s^2]
            response_max_interval_s: after a longer time without a measurement the estimate begins anew [s]
        """

    @property
    def dt_s(self) -> float:
        """a tick [s]"""

    @property
    def controller_ticks(self) -> int:
        """ticks for which the nominal command is held"""

    @property
    def filter_ticks(self) -> int:
        """ticks for which the filters' command is held"""

    @property
    def stale_s(self) -> float:
        """a measurement older than this is not predicted any more [s]"""

    @property
    def has_losses(self) -> bool:
        """measurements can be missing"""

    @property
    def disturbance_time_s(self) -> float:
        """time constant of the estimate of disturbances; 0: none [s]"""

    @property
    def disturbance_max_m_s2(self) -> float:
        """maximum length of the estimate [m/s^2]"""

    @property
    def disturbance_max_interval_s(self) -> float:
        """
        after a longer time without a measurement the estimate goes on from the next one [s]
        """

    @property
    def response_time_s(self) -> float:
        """
        time constant of the estimate of what a vehicle's response leaves out; 0: none [s]
        """

    @property
    def response_room_m_s2(self) -> float:
        """
        by which the interval of expected accelerations is wider on both sides [m/s^2]
        """

    @property
    def response_delay_s(self) -> float:
        """a command of this age may be the one that is followed [s]"""

    @property
    def response_shortest_lag_s(self) -> float:
        """shortest lag of a vehicle that follows velocities [s]"""

    @property
    def response_jerk_m_s3(self) -> float:
        """with which accelerations are followed at least [m/s^3]"""

    @property
    def response_release_s(self) -> float:
        """time constant with which the bound decays [s]"""

    @property
    def response_max_m_s2(self) -> float:
        """maximum length of the estimate [m/s^2]"""

    @property
    def response_max_interval_s(self) -> float:
        """after a longer time without a measurement the estimate begins anew [s]"""

class Losses:
    """Losses of measurements and of the pilot's radio."""

    def __init__(self, *, share: float = 0.0, from_s: float = float('inf'), for_s: float = 0.0, radio_from_s: float = float('inf'), radio_for_s: float = 0.0) -> None:
        """
        Args:
            share: probability that a measurement is lost
            from_s: beginning of an outage [s]
            for_s: its duration [s]
            radio_from_s: beginning of an outage of the pilot's radio [s]
            radio_for_s: its duration [s]
        """

    @property
    def share(self) -> float:
        """probability that a measurement is lost"""

    @property
    def from_s(self) -> float:
        """beginning of an outage [s]"""

    @property
    def for_s(self) -> float:
        """its duration [s]"""

    @property
    def radio_from_s(self) -> float:
        """beginning of an outage of the pilot's radio [s]"""

    @property
    def radio_for_s(self) -> float:
        """its duration [s]"""

class SimulationRules:
    """Timing of a simulation, and when a flight ends."""

    def __init__(self, *, plant_steps: int = 10, stop_speed_m_s: float = 0.1, stuck_speed_m_s: float = 0.02, stuck_ticks: int = 200, receded_s: float = float('inf'), lower: Sequence[float] = [-1000000000.0, -1000000000.0, -1000000000.0], upper: Sequence[float] = [1000000000.0, 1000000000.0, 1000000000.0], ends_when_refused: bool = True, ends_at_goal: bool = True, risk_window_s: float = 0.4, keeps_path: bool = True, keeps_ticks: bool = True) -> None:
        """
        Args:
            plant_steps: steps of the plant in a tick
            stop_speed_m_s: reached when slower than this, with the reference at its end [m/s]
            stuck_speed_m_s: stuck below this speed, away from the reference [m/s],
            stuck_ticks: for this many ticks
            receded_s: ends when all obstacles have receded for so long [s]
            lower: lower corner of the box that must not be left [m]
            upper: upper corner of that box [m]
            ends_when_refused: a refused command ends the flight
            ends_at_goal: a goal that is reached ends the flight, and being stuck
            risk_window_s: window of the risk of encounters [s]
            keeps_path: the path is kept
            keeps_ticks: a complete row per tick is kept, not only what a judge counts
        """

    @property
    def plant_steps(self) -> int:
        """steps of the plant in a tick"""

    @property
    def stop_speed_m_s(self) -> float:
        """reached when slower than this, with the reference at its end [m/s]"""

    @property
    def stuck_speed_m_s(self) -> float:
        """stuck below this speed, away from the reference [m/s],"""

    @property
    def stuck_ticks(self) -> int:
        """for this many ticks"""

    @property
    def receded_s(self) -> float:
        """ends when all obstacles have receded for so long [s]"""

    @property
    def lower(self) -> list[float]:
        """lower corner of the box that must not be left [m]"""

    @property
    def upper(self) -> list[float]:
        """upper corner of that box [m]"""

    @property
    def ends_when_refused(self) -> bool:
        """a refused command ends the flight"""

    @property
    def ends_at_goal(self) -> bool:
        """a goal that is reached ends the flight, and being stuck"""

    @property
    def risk_window_s(self) -> float:
        """window of the risk of encounters [s]"""

    @property
    def keeps_path(self) -> bool:
        """the path is kept"""

    @property
    def keeps_ticks(self) -> bool:
        """a complete row per tick is kept, not only what a judge counts"""

class Mission:
    """What makes the nominal command."""

    @staticmethod
    def along(curve: ReferenceCurve, *, gain_per_s: float = 2.0, speed_m_s: float = float('inf'), hovers: bool = False, clock: PlanClockOptions | None = None) -> Mission:
        """
        Track a curve; with `hovers` until the time is over; with a `clock` its time waits for the vehicle.
        """

    @staticmethod
    def to(goal: Sequence[float], *, gain_per_s: float = 2.0, speed_m_s: float = float('inf'), hovers: bool = False) -> Mission:
        """Straight to a goal; with `hovers` hold it."""

    @staticmethod
    def given(*, gain_per_s: float = 2.0, speed_m_s: float = float('inf')) -> Mission:
        """Track the reference point of each tick."""

    @staticmethod
    def by_sticks() -> Mission:
        """By the sticks of a pilot."""

class Task:
    """
    A trial: its start, its mission, and a simulated pilot where it flies by sticks.
    """

    def __init__(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], mission: Mission, *, pilot: Pilot | None = None, max_time_s: float = 60.0, stop_distance_m: float = 0.05, expected_velocity_m_s: Sequence[float] | None = None) -> None:
        """
        start: position, attitude (MRP), velocity, body rates, or of a racer position, velocity, attitude (unit
        quaternion w, x, y, z), body rates; expected_velocity_m_s: by which obstacles are drawn to meet the
        vehicle, else the mean velocity of the mission.
        """

    @property
    def max_time_s(self) -> float:
        """Maximum duration [s]."""

class SimulationSpec:
    """All parts of simulated flights but the tasks and the filters."""

    def __init__(self, vehicle: VehicleSpec, *, options: FlightOptions = ..., rules: SimulationRules = ..., losses: Losses = ..., moving: MovingSpec = ..., fence: Geofence | None = None, watcher: SafetyFilter | None = None) -> None:
        """
        fence: by whose fence and limits flights of a racer are judged; watcher: filter of accelerations among
        moving obstacles that is not flown, for the metrics of encounters without one that is.
        """

def simulate(spec: SimulationSpec, tasks: Sequence[Task], filters: Sequence[SafetyFilter], *, seed: int = 0, first_trial: int = 0, jobs: int = 0, progress: object | None = None) -> list[dict[str, Any]]:
    """
    Fly every task behind clones of the filters, in their order; per flight a dict of arrays with a row per tick: alula/flight/simulation.hpp.
    """

class Flight:
    """A flight as the computer on board sees it: observe, then decide."""

    def __init__(self, vehicle: VehicleSpec, options: FlightOptions, mission: Mission, filters: Sequence[SafetyFilter]) -> None: ...

    def observe(self, now_s: float, measured: Annotated[NDArray[numpy.float64], dict(shape=(12), order='C', device='cpu', writable=False)] | None, *, tracks: bytes = ..., position_variance: Sequence[float] = [0.0, 0.0, 0.0], sticks: Sequence[float] | None = None, target: Annotated[NDArray[numpy.float64], dict(shape=(18), order='C', device='cpu', writable=False)] | None = None, age_s: float | None = None, slip_m: float = 0.0) -> None:
        """
        The newest measurement (p, sigma, v, omega), or None; `tracks` as `simulate` returns them; `target` as
        of ReferenceCurve.at; age_s of the measurement, in place of the assumed delay [s]; `slip_m`, by which position
        and integrated velocity differ, which margins grow by.
        """

    def reset(self) -> None:
        """Before another flight, and when others have flown the vehicle."""

    def sent(self, interface: object | None = None, values: Sequence[float] | None = None) -> None:
        """
        What was decided was sent for this tick; or another command: a velocity, an acceleration (the first three
        values), a thrust [N] with torque, or with body rates.
        """

    def decide(self) -> dict[str, Any]:
        """
        A dict: command (11), is_refused, is_stale, is_limited, estimate, and a record of each filter.
        """
