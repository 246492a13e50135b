"""Mutated meshes, clouds and octrees against `import-voxels` and `verify --source`: `--seconds 600`.

A case must give voxels that their own proof accepts, or one of alula's own errors: no other exception, no
crash, no hang, no allocation that the file does not justify, and no file whose readers find other triangles
or points than the count of its bytes. What fails is kept in --keep.
"""

from __future__ import annotations

import argparse
import faulthandler
import random
import sys
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from support.fuzz.fuzz_splats import Case, fuzz, limit_memory

COUNTED = "were read; please report"  # a reader and the count of the bytes disagree
MOST = 20_000  # voxels
WRITTEN = 40  # seeds of each kind
SIZES = (0.05, 0.25, 2.0)


def seeds() -> dict[str, Case]:
    """Valid files by name, and octrees of both kinds."""
    from support.files.mesh_files import WRITERS

    found = {}
    for kind, write in WRITERS.items():
        for number in range(WRITTEN):
            written = write(random.Random(f"{kind}/{number}"))
            name = f"a{written.suffix}"
            found[f"{written.suffix[1:]}:{number}"] = Case({name: written.raw}, name)
    head = b"# Octomap OcTree %s\nid OcTree\nsize %d\nres 0.05\ndata\n"
    inner = b"\x03\x00" * 15 + b"\x55\xaa"  # one branch to the finest level
    found["bt:0"] = Case({"a.bt": head % (b"binary file", 24) + inner}, "a.bt")
    node = b"\0\0\x80\x3f"
    found["ot:0"] = Case({"a.ot": head % (b"file", 17) + (node + b"\x01") * 16 + node + b"\0"}, "a.ot")
    return found


def run_case(case: Case, folder: Path) -> str:
    """`read`, `empty` or `refused`.

    Raises:
        BaseException: whatever must not come out; AssertionError for a wrong count or a proof that fails.
    """
    import numpy as np

    from alula.schemas.errors import AlulaError, InfeasibleError
    from alula.schemas.parameters.configs.import_voxels import ImportVoxelsConfig
    from alula.stages.compression.import_voxels import import_voxels
    from alula.stages.compression.imported import Cloud
    from alula.stages.compression.imported_files import read_imported
    from alula.stages.compression.verify_imported import imported_checks

    assert case.main is not None
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / case.main
    path.write_bytes(case.files[case.main])
    try:
        source = read_imported(path)
        size = SIZES[len(case.files[case.main]) % len(SIZES)]
        margin = 0.1 if isinstance(source, Cloud) else 0.0
        config = ImportVoxelsConfig(size_m=size, margin_m=margin, max_voxels=MOST)
        voxels = import_voxels(config, source, jobs=1)
    except InfeasibleError:
        return "empty"
    except AlulaError as error:
        words = str(error)
        assert COUNTED not in words, words
        assert "\n" not in words, "the message has several lines"
        assert len(words) < 1000, "the message is too long"
        return "refused"
    checks = imported_checks(voxels.manifest, source, voxels.arrays["index"], jobs=1)
    assert not any(check.failed for check in checks), "the proof of its own voxels fails"
    assert np.isfinite(voxels.arrays["index"]).all()
    return "read"


def main() -> int:
    """Run from the command line; 1 when anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-failures"))
    chosen = parser.parse_args()
    chosen.keep.mkdir(parents=True, exist_ok=True)
    faulthandler.enable()
    warnings.simplefilter("error")
    fuzz(2.0, 0, chosen.keep, 20, inputs=seeds(), run=run_case)  # the imports
    limit_memory()
    counts = fuzz(chosen.seconds, chosen.seed, chosen.keep, inputs=seeds(), run=run_case)
    for key in sorted(counts):
        print(f"{counts[key]:9d}  {key}")
    return 1 if counts["FAILED"] else 0


if __name__ == "__main__":
    sys.exit(main())
