"""Segment Anything models by name, and importing segment_anything where torchvision cannot be imported."""

import importlib
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from piegraph_cli.errors import DataError, MissingError, UsageError


@dataclass(frozen=True)
class SamSize:
    """The sizes that tell one Segment Anything model from another."""

    width: int
    depth: int
    heads: int
    global_layers: tuple[int, ...]
    """Encoder layers that attend to the whole image; the others to windows."""
    image_size: int = 1024
    window: int = 14
    prompt_width: int = 256
    decoder_mlp: int = 2048
    decoder_heads: int = 8


SAM_MODELS = {
    "vit_h": SamSize(1280, 32, 16, (7, 15, 23, 31)),
    "vit_l": SamSize(1024, 24, 16, (5, 11, 17, 23)),
    "vit_b": SamSize(768, 12, 12, (2, 5, 8, 11)),
    "tiny": SamSize(96, 4, 4, (1, 3), image_size=256, window=8, prompt_width=64, decoder_mlp=128, decoder_heads=4),
}
"""The published sizes, and one small enough to be trained in minutes on a CPU."""


def load_sam(checkpoint: Path, model: str, device: str = "cpu") -> Any:
    """The official `Sam` of kind `model` (a key of `SAM_MODELS`) with weights from a state dict file, ready to predict.

    The file is read with `weights_only=True`: it cannot run code. Raises UsageError for an unknown model, MissingError
    where segment_anything or the file is missing, DataError where the weights cannot be read or do not fit.
    """
    import torch

    if not checkpoint.is_file():
        raise MissingError(
            "the Segment Anything weights are missing",
            str(checkpoint),
            f"run `piegraph doctor --fetch sam-{model.replace('_', '-')}`, or give a file with --sam-checkpoint",
        )
    sam = build_sam(model)
    hint = f"give weights of a {model} model, or another --sam-model ({', '.join(SAM_MODELS)})"
    try:
        sam.load_state_dict(torch.load(checkpoint, map_location="cpu", weights_only=True))
    except Exception as error:
        first_line = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise DataError(f"cannot be read as Segment Anything weights: {first_line}", str(checkpoint), hint) from None
    return sam.to(device).eval()


def build_sam(model: str) -> Any:
    """A `Sam` module of the official classes with random weights; `model` is a key of `SAM_MODELS`."""
    import torch

    if model not in SAM_MODELS:
        raise UsageError(f"no Segment Anything model {model!r}", hint=f"choose one of {', '.join(SAM_MODELS)}")
    size = SAM_MODELS[model]
    parts = import_segment_anything("segment_anything.modeling")
    grid = size.image_size // 16
    return parts.Sam(
        image_encoder=parts.ImageEncoderViT(
            depth=size.depth,
            embed_dim=size.width,
            img_size=size.image_size,
            mlp_ratio=4,
            norm_layer=partial(torch.nn.LayerNorm, eps=1e-6),
            num_heads=size.heads,
            patch_size=16,
            qkv_bias=True,
            use_rel_pos=True,
            global_attn_indexes=size.global_layers,
            window_size=size.window,
            out_chans=size.prompt_width,
        ),
        prompt_encoder=parts.PromptEncoder(
            embed_dim=size.prompt_width,
            image_embedding_size=(grid, grid),
            input_image_size=(size.image_size, size.image_size),
            mask_in_chans=16,
        ),
        mask_decoder=_mask_decoder(parts, size),
        pixel_mean=[123.675, 116.28, 103.53],
        pixel_std=[58.395, 57.12, 57.375],
    )


def _mask_decoder(parts: Any, size: SamSize) -> Any:
    transformer = parts.TwoWayTransformer(
        depth=2, embedding_dim=size.prompt_width, mlp_dim=size.decoder_mlp, num_heads=size.decoder_heads
    )
    return parts.MaskDecoder(
        num_multimask_outputs=3,
        transformer=transformer,
        transformer_dim=size.prompt_width,
        iou_head_depth=3,
        iou_head_hidden_dim=size.prompt_width,
    )


def import_segment_anything(module: str = "segment_anything") -> Any:
    """Import segment_anything or one of its modules; a stand-in serves it where torchvision fails to import.

    Raises MissingError where the package is not installed.
    """
    if module in sys.modules:
        return sys.modules[module]
    try:
        with _torchvision():
            return importlib.import_module(module)
    except ImportError as error:
        raise MissingError(f"segment_anything cannot be imported: {error}", hint="run `make setup`") from None


@contextmanager
def _torchvision() -> Iterator[None]:
    """torchvision, or a stand-in with the four functions segment_anything takes from it, for the time of an import."""
    before = set(sys.modules)
    try:
        importlib.import_module("torchvision")
        yield
        return
    except Exception:  # a build that does not match torch fails with RuntimeError, OSError or ImportError
        for name in set(sys.modules) - before:
            if name.split(".")[0] == "torchvision":
                del sys.modules[name]
    stand_in = _stand_in()
    sys.modules.update(stand_in)
    try:
        yield
    finally:
        for name in stand_in:
            sys.modules.pop(name, None)


def _stand_in() -> dict[str, types.ModuleType]:
    names = ("", ".ops", ".ops.boxes", ".transforms", ".transforms.functional")
    modules = {f"torchvision{name}": types.ModuleType(f"torchvision{name}") for name in names}
    vars(modules["torchvision.ops.boxes"]).update(batched_nms=batched_nms, box_area=box_area)
    vars(modules["torchvision.transforms.functional"]).update(resize=resize, to_pil_image=to_pil_image)
    return modules


def to_pil_image(image: Any) -> Any:
    """A PIL image of a uint8 array [H, W, 3]."""
    from PIL import Image

    return Image.fromarray(image)


def resize(image: Any, size: tuple[int, int]) -> Any:
    """A PIL image resized to (height, width), bilinear with antialiasing."""
    from PIL import Image

    return image.resize(size[::-1], Image.Resampling.BILINEAR)


def box_area(boxes: Any) -> Any:
    """Areas [N] of boxes [N, 4] (left, top, right, bottom)."""
    return (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])


def batched_nms(boxes: Any, scores: Any, groups: Any, iou_threshold: float) -> Any:
    """Indices of boxes [N, 4] kept by non-maximum suppression within each group [N], by falling score [N]."""
    import torch

    order = scores.argsort(descending=True, stable=True)
    boxes, groups = boxes[order], groups[order]
    corner = torch.maximum(boxes[:, None, :2], boxes[None, :, :2])
    opposite = torch.minimum(boxes[:, None, 2:], boxes[None, :, 2:])
    overlap = (opposite - corner).clamp(min=0).prod(dim=-1)
    area = box_area(boxes)
    iou = overlap / (area[:, None] + area[None, :] - overlap)
    suppresses = (iou > iou_threshold) & (groups[:, None] == groups[None, :])
    kept = torch.ones(len(boxes), dtype=torch.bool, device=boxes.device)
    for n in range(len(boxes)):
        if kept[n]:
            kept[n + 1 :] &= ~suppresses[n, n + 1 :]
    return order[kept]
