"""The output folder of nerfstudio's splatfacto, and its checkpoints."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.schemas.progress import Progress
from alula.stages.reconstruction.formats.checkpoint import Checkpoint, is_checkpoint
from alula.stages.reconstruction.formats.ply import decode_ply
from alula.stages.reconstruction.formats.properties import FILTER, FILTER_WORDS, filtered, judged
from alula.stages.reconstruction.formats.source import Source
from alula.stages.reconstruction.formats.splats import Properties, Splats, color_from_sh0, exp, logistic
from alula.stages.reconstruction.formats.torch_pickle import Tensor

FRAME = "nerfstudio training frame"
_CONFIG, _TRANSFORMS, _EXPORTED = "config.yml", "dataparser_transforms.json", "splat.ply"
_CONFIG_LIMIT = 2**18
_TRANSFORMS_LIMIT = 2**20
_ALIASES = 1000
_DEPTH = 100
_CHUNK = 2**16
_SHAPES = {"means": (3,), "scales": (3,), "quats": (4,), "opacities": (1,), "features_dc": (3,)}


def is_nerfstudio(source: Source) -> bool:
    """Test whether a source is a folder that nerfstudio wrote, the configuration in it, or a checkpoint."""
    if source.is_folder or source.path.name == _CONFIG:
        return source.has(_CONFIG) and (source.has(_TRANSFORMS) or bool(_checkpoints(source)))
    return is_checkpoint(source.head)


def members_of_nerfstudio(source: Source) -> Sequence[str]:
    """Names of the checkpoint or of its export, and of the files that describe its frame."""
    if not _is_run(source):
        return (source.path.name,)
    checkpoints = _checkpoints(source)
    if not checkpoints and not source.has(_EXPORTED):
        raise ArtifactError("nerfstudio: no nerfstudio_models/step-*.ckpt and no splat.ply")
    main = checkpoints[max(checkpoints)] if checkpoints else _EXPORTED
    return (main, *(name for name in (_CONFIG, _TRANSFORMS) if source.has(name)))


def decode_nerfstudio(source: Source, progress: Progress | None = None) -> Splats:
    """Decode the Gaussians of splatfacto, in the frame that it was trained in.

    scale = exp(scales), opacity = 1 / (1 + exp(-opacities)), evaluated in double precision and rounded
    to single; quaternions are w, x, y, z, unnormalised. Colours are those of the constant harmonic, or,
    if there are no higher ones (`sh_degree` 0), 1 / (1 + exp(-features_dc)). The checkpoint is of the
    last step; without one, `splat.ply` is read, which `ns-export` makes.

    The training frame is p = s (A p_original + b), which is metric only if s is 1 and the poses were. It is
    not changed.

    Args:
        source: the folder with `config.yml`, that file itself, or one checkpoint.

    Raises:
        ArtifactError: the files are damaged, of another method, or would need to run code.
        InputError: a file cannot be read.
    """
    if not _is_run(source):
        return _decode_checkpoint(source.data, "", (), progress)
    method = _method(source)
    note = _frame_note(source)
    main = members_of_nerfstudio(source)[0]
    if main == _EXPORTED:
        splats = decode_ply(source.member(_EXPORTED), progress)
        return dataclasses.replace(
            splats,
            tags=splats.tags | {"frame": FRAME},
            notes=(f"no checkpoint: {_EXPORTED} was read", note, *splats.notes),
        )
    steps = _checkpoints(source)
    more = f", the last of {len(steps)}" if len(steps) > 1 else ""
    return _decode_checkpoint(
        source.member(main), method, (f"checkpoint of step {max(steps)}{more}", note), progress
    )


def _is_run(source: Source) -> bool:
    return source.is_folder or source.path.name == _CONFIG


def _checkpoints(source: Source) -> dict[int, str]:
    """Names of checkpoints by step."""
    return {
        int(found[1]): f"nerfstudio_models/{file.name}"
        for file in source.folder.glob("nerfstudio_models/step-*.ckpt")
        if (found := re.fullmatch(r"step-([0-9]{1,12})\.ckpt", file.name))
    }


def _decode_checkpoint(
    buffer: memoryview, method: str, notes: tuple[str, ...], progress: Progress | None
) -> Splats:
    checkpoint = Checkpoint(buffer)
    tensors, others = _parameters(checkpoint.tree, method)
    count = tensors["means"].shape[0] if tensors["means"].shape else 0
    arrays: dict[str, NDArray[Any]] = {}
    for name, row in _SHAPES.items():
        shape = tensors[name].shape
        if shape != (count, *row):
            raise ArtifactError(f"nerfstudio: {name} has shape {shape}, not {(count, *row)}")
        arrays[name] = checkpoint.array(tensors[name], name)
    rest = tensors.get("features_rest")
    if rest is not None:
        if len(rest.shape) != 3 or rest.shape[0] != count or rest.shape[2] != 3:
            raise ArtifactError(f"nerfstudio: features_rest has shape {rest.shape}, not ({count}, K, 3)")
        if rest.shape[1] not in (0, 3, 8, 15, 24):
            raise ArtifactError(f"nerfstudio: features_rest has {rest.shape[1]} coefficients; not a degree")
        checkpoint.array(rest, "features_rest")
    if count == 0:
        raise ArtifactError("nerfstudio: has no Gaussians (means of 0 rows)")
    logits = rest is not None and rest.shape[1] == 0
    unknown = judged(others, applied=(FILTER,))
    filter_3d = None
    if FILTER in others:
        if others[FILTER].shape not in ((count,), (count, 1)):
            raise ArtifactError(f"nerfstudio: {FILTER} has shape {others[FILTER].shape}, not ({count}, 1)")
        filter_3d = checkpoint.array(others[FILTER], FILTER).reshape(count).astype(np.float32)

    mean, scale = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    quat, color = np.empty((count, 4), np.float32), np.empty((count, 3), np.uint8)
    alpha = np.empty(count, np.float32)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        for start in range(0, count, _CHUNK):
            part = slice(start, min(start + _CHUNK, count))
            mean[part], quat[part] = arrays["means"][part], arrays["quats"][part]
            scale[part] = exp(arrays["scales"][part])
            alpha[part] = logistic(arrays["opacities"][part])[:, 0]
            values = arrays["features_dc"][part]
            color[part] = (
                np.rint(255.0 * np.nan_to_num(logistic(values))) if logits else color_from_sh0(values)
            )
            if progress is not None:
                progress(part.stop, count)
    if filter_3d is not None:
        scale, alpha = filtered(scale, alpha, filter_3d)
    return Splats(
        format="nerfstudio",
        mean=mean,
        scale=scale,
        quat_wxyz=quat,
        opacity=alpha,
        color=color,
        tags={"frame": FRAME} | ({"generator": f"nerfstudio {method}"} if method else {}),
        notes=notes or ("the frame is nerfstudio's of training, whose scale only its folder tells",),
        properties=Properties((FILTER_WORDS,) if filter_3d is not None else (), unknown),
    )


def _parameters(tree: Any, method: str) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """The tensors of the Gaussians that are read, and further ones, by name, from a checkpoint of any age."""
    state = tree.get("pipeline") if isinstance(tree, dict) else None
    if not isinstance(state, dict) and isinstance(tree, dict) and isinstance(tree.get("splats"), dict):
        raise ArtifactError("checkpoint of gsplat: import the .ply that its trainer saves (--save_ply)")
    if not isinstance(state, dict):
        raise ArtifactError("nerfstudio: the checkpoint has no 'pipeline', so nerfstudio did not write it")
    found, others = {}, {}
    for key, value in state.items():
        if isinstance(key, str) and isinstance(value, Tensor):
            key = key.removeprefix("module.").replace("_model.module.", "_model.", 1)
            match = re.fullmatch(r"_model\.(gauss_params\.)?(\w+)", key)
            if match is None:
                continue
            if match[2] in _SHAPES or match[2] == "features_rest":
                found[match[2]] = value
            elif match[1] or match[2] == FILTER:
                others[match[2]] = value
    missing = [name for name in _SHAPES if name not in found]
    if missing == list(_SHAPES):
        raise ArtifactError(
            f"nerfstudio: {method or 'this model'} is no Gaussian splat: it has no gauss_params"
        )
    if missing:
        raise ArtifactError(f"nerfstudio: the checkpoint lacks {missing[0]} among its gauss_params")
    return found, others


def _method(source: Source) -> str:
    """Name of the method in `config.yml`; methods that are known not to be splats are refused."""
    config = _plain_yaml(source.member(_CONFIG)) if source.has(_CONFIG) else {}
    if not isinstance(config, dict):
        raise ArtifactError(f"nerfstudio: {_CONFIG} is not a mapping")
    method = config.get("method_name")
    if not isinstance(method, str):
        raise ArtifactError(f"nerfstudio: {_CONFIG} names no method")
    if re.fullmatch(
        r"(depth-)?nerfacto.*|instant-ngp.*|mipnerf|vanilla-nerf|tensorf|neus.*|semantic-.*", method
    ):
        raise ArtifactError(f"nerfstudio: {method[:50]} is no Gaussian splat; splatfacto is one")
    return method[:100]


def _plain_yaml(data: memoryview) -> Any:
    """YAML as dictionaries, lists and strings; tags are ignored, so they cannot name anything to run.

    Raises:
        ArtifactError: not YAML, or of a size that no configuration has.
    """
    import yaml

    if len(data) > _CONFIG_LIMIT:
        raise ArtifactError(f"nerfstudio: {_CONFIG} has {len(data)} bytes; more than {_CONFIG_LIMIT}")

    class Plain(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML has no types
        """Loader that makes containers and strings only and ignores tags."""

        yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012
        yaml_constructors: dict[str, Any] = {}  # noqa: RUF012

        def flatten_mapping(self, node: Any) -> None:
            """Do not merge `<<`: the result of merging has no size limit."""

        def plain(self, _tag: str, node: Any) -> Any:
            if isinstance(node, yaml.MappingNode):
                return self.construct_mapping(node, deep=True)
            if isinstance(node, yaml.SequenceNode):
                return self.construct_sequence(node, deep=True)
            return self.construct_scalar(node)

    Plain.add_multi_constructor("", Plain.plain)
    text = bytes(data)
    try:
        depth = aliases = 0
        for event in yaml.parse(text, Loader=Plain):  # deep nesting takes PyYAML quadratic time
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            aliases += isinstance(event, yaml.AliasEvent)
            if depth > _DEPTH or aliases > _ALIASES:
                what = (
                    f"is nested more than {_DEPTH} deep"
                    if depth > _DEPTH
                    else f"has more than {_ALIASES} aliases"
                )
                raise ArtifactError(f"nerfstudio: {_CONFIG} {what}")
        return yaml.load(text, Loader=Plain)
    # Besides its own errors PyYAML raises those of bad escapes and of numbers in directives.
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ArtifactError(f"nerfstudio: {_CONFIG} is not YAML: {reason}") from error


class _Transforms(msgspec.Struct):
    transform: list[list[float]]
    scale: float


def _frame_note(source: Source) -> str:
    """Note about the frame, from `dataparser_transforms.json`."""
    if not source.has(_TRANSFORMS):
        return f"the frame is nerfstudio's of training, whose scale is not known without {_TRANSFORMS}"
    data = source.member(_TRANSFORMS)
    if len(data) > _TRANSFORMS_LIMIT:
        raise ArtifactError(f"nerfstudio: {_TRANSFORMS} has {len(data)} bytes; more than {_TRANSFORMS_LIMIT}")
    try:
        found = msgspec.json.decode(data, type=_Transforms)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ArtifactError(f"nerfstudio: {_TRANSFORMS}: {error}") from error
    if [len(row) for row in found.transform] != [4, 4, 4] or not 0.0 < found.scale < math.inf:
        raise ArtifactError(f"nerfstudio: {_TRANSFORMS} is no 3 by 4 transform with a positive scale")
    return (
        f"the frame is nerfstudio's of training: that of the poses turned, shifted and times "
        f"{found.scale:.9g}; `alula scale-align --nerfstudio DIR` undoes it"
    )
