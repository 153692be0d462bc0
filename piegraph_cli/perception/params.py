"""Settings of `hands`, `segment` and `fuse`."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from piegraph_cli.params import Params


class HandsParams(Params):
    """Settings of `hands`."""

    later = ("source", "stick_radius")

    source: Literal["auto", "hand", "file", "stick", "glove"] = Field(
        "auto",
        description="what the end-effector is: a hand, what the recording has of it, a round stick or a hand in a glove by "
        "depth alone; auto: from the recording where it has one, else the hand",
    )
    stick_radius: float = Field(0.01, gt=0, le=0.03, description="radius of the stick [m]")
    hand_model: Path | None = Field(None, description="hand_landmarker.task file (default: the fetched one)")
    max_gap: float = Field(0.5, ge=0, description="longest gap in the hand's path that is filled [s]")


class SegmentParams(Params):
    """Settings of `segment`."""

    segmenter: Literal["grabcut", "sam"] = Field("grabcut", description="how the object's mask is found")
    min_height: float = Field(0.006, gt=0, description="height above the table from which depth tells the object [m]")
    min_contrast: float = Field(
        0.25, gt=0, description="colour difference from the table that tells the object [log ratio]"
    )
    min_area: float = Field(4e-4, gt=0, description="smallest object, as table area covered [m2]")
    sam_checkpoint: Path | None = Field(None, description="weights for --segmenter sam")
    sam_model: Literal["vit_h", "vit_l", "vit_b", "tiny"] = Field("vit_b", description="SAM model of the checkpoint")
    sam_every: int = Field(10, ge=1, description="frames between SAM key frames; masks are propagated between them")
    prompts: dict[str, tuple[float, float, float, float]] = Field(
        {},
        description="box x0,y0,x1,y1 [px] in the first frame, per CAMERA, or SEQUENCE/CAMERA for one sequence alone; "
        "other cameras follow by its place",
    )
    points: dict[str, tuple[float, float]] = Field(
        {},
        description="point x,y [px] on the object in the first frame, per CAMERA, or SEQUENCE/CAMERA for one sequence "
        "alone; other cameras follow",
    )

    def sequences(self) -> set[str]:
        """The sequences that have prompts of their own."""
        return {name.rpartition("/")[0] for name in (*self.prompts, *self.points)} - {""}

    def of(self, sequence: str) -> "SegmentParams":
        """The settings of one sequence, prompts per camera: its own ones, where it has any, in place of those for all."""
        of = sequence if sequence in self.sequences() else ""

        def own(prompts: dict) -> dict:
            return {name.rpartition("/")[2]: px for name, px in prompts.items() if name.rpartition("/")[0] == of}

        return self.model_copy(update={"prompts": own(self.prompts), "points": own(self.points)})

    def prompted(self, sequence: str, prompts: dict, points: dict) -> "SegmentParams":
        """These settings with the prompts of one sequence, per camera, in place of its own; of all sequences for ''."""

        def with_own(old: dict, new: dict) -> dict:
            others = {name: px for name, px in old.items() if name.rpartition("/")[0] != sequence}
            return others | {f"{sequence}/{camera}" if sequence else camera: px for camera, px in new.items()}

        return self.model_copy(
            update={"prompts": with_own(self.prompts, prompts), "points": with_own(self.points, points)}
        )


class FuseParams(Params):
    """Settings of `fuse`."""

    later = ("closed",)

    voxel_size: float = Field(0.004, gt=0, description="edge of the voxel grid the cloud is thinned on [m]")
    contact_radius: float = Field(0.03, gt=0, description="hand and object closer than this touch [m]")
    closed: float | None = Field(
        None, description="opening up to which a gripper holds (default: halfway between its least and largest) [m]"
    )
