"""What each artifact holds: the one table of dataset names with their axes, units, types and what their values may be."""

from dataclasses import dataclass

SCHEMA_VERSION = 2
"""Artifacts of version 1 are read as well: they have no checksum."""

INF = float("inf")


@dataclass(frozen=True)
class Field:
    """One dataset: `axes` by name, `units`, numpy `dtype`.

    Equal names have equal length within a file; an axis `NAME_edge` is one longer than `NAME`.
    """

    axes: str
    units: str
    dtype: str
    nan: bool = False
    """NaN marks what was not observed; otherwise every value must be finite."""
    ends: str = ""
    """Of offsets: the dataset they cut into parts. They start at 0, never fall, and end at its length."""
    optional: bool = False
    """Whether an artifact may do without."""
    low: float | None = None
    high: float | None = None
    """What values lie between, in place of the bounds of the units."""
    index: str = ""
    """Of whole numbers that name entries of an axis: that axis."""
    rises: bool = False
    """Whether each value is greater than the one before it."""
    pose: bool = False
    """Whether each 4 x 4 matrix is a rotation and a shift."""

    @property
    def bounds(self) -> tuple[float, float] | None:
        """Least and greatest value there may be; None where anything may be."""
        low, high = BOUNDS.get(self.units, (None, None))
        low, high = low if self.low is None else self.low, high if self.high is None else self.high
        return None if low is None or high is None else (low, high)


BOUNDS: dict[str, tuple[float, float]] = {
    "m": (-100, 100),
    "m a frame": (0, 100),
    "s": (-1e11, 1e11),
    "px": (-1e6, 1e6),
    "cm": (0, INF),
    "cm^2": (0, INF),
    "byte": (0, INF),
    "0 push, 1 pick": (0, 1),
    "0 train, 1 validation, 2 test": (0, 2),
    "0 hand, 1 file, 2 what comes in": (0, 2),
    "stroke, -1 none": (-1, INF),
}
"""By units, what values lie between, both included; of units that are not here anything finite may be."""


FIXED_AXES = {
    "xyz": 3,
    "xy": 2,
    "wh": 2,
    "first_last": 2,
    "landmark": 21,
    "start_end": 2,
    "least_most": 2,
    "measure": 4,
}
"""Axes whose length is the same in every file; `3`, `4`, `5` in `axes` stand for themselves."""

TEXT, LONG_TEXT = "S128", "S512"

_TIME = Field("frame", "s", "float64", rises=True)
_OPENING = Field("frame", "m, or as recorded", "float64", nan=True, optional=True)
_HAND_PATH = {
    "end_effector": Field("frame,xyz", "m", "float32", nan=True),
    "contact": Field("frame", "1", "bool"),
    "time": _TIME,
}

_STEPS = {
    "stroke": Field("step,start_end,xy", "m", "float32"),
    "mode": Field("step", "0 push, 1 pick", "uint8"),
    "before": Field("step,particle,xyz", "m", "float32"),
    "predicted": Field("step,particle,xyz", "m", "float32", low=-1e6, high=1e6),
    "after": Field("step,particle,xyz", "m", "float32", nan=True),
    "cost": Field("step", "m", "float64", high=INF),
    "expected_error": Field("step", "m", "float64", nan=True, low=0, high=INF),
    "distance": Field("step", "m", "float64", nan=True, low=0, high=INF),
    "blocked": Field("step", "1", "bool"),
    "seconds": Field("step", "s", "float64", low=0),
    "candidate_stroke": Field("step,iteration,candidate,horizon,start_end,xy", "m", "float32", nan=True),
    "candidate_mode": Field("step,iteration,candidate,horizon", "0 push, 1 pick", "uint8"),
    "candidate_cost": Field("step,iteration,candidate", "m", "float32", nan=True, low=-INF, high=INF),
    "candidate_weight": Field("step,iteration,candidate", "1", "float32", low=0, high=1),
}

SCHEMAS: dict[str, dict[str, Field]] = {
    "frames": {
        "color": Field("color_byte", "encoded image", "uint8"),
        "color_offsets": Field("image_edge", "byte", "int64", ends="color"),
        "depth": Field("depth_byte", "encoded image", "uint8"),
        "depth_offsets": Field("image_edge", "byte", "int64", ends="depth"),
        "mask": Field("mask_byte", "encoded image", "uint8", optional=True),
        "mask_offsets": Field("image_edge", "byte", "int64", ends="mask", optional=True),
        "time": _TIME,
        "source_frame": Field("frame,camera", "1", "int64", low=-1, high=INF),
        "camera_name": Field("camera", "text", TEXT),
        "image_size": Field("camera,wh", "px", "int64", low=1),
        "K": Field("camera,3,3", "px", "float64"),
        "distortion": Field("camera,coefficient", "1", "float64"),
        "depth_scale": Field("camera", "m", "float64", low=0),
        "T_world_camera": Field("camera,4,4", "m", "float64", pose=True),
        "end_effector": Field("frame,xyz", "m", "float64", nan=True, optional=True),
        "opening": _OPENING,
        "stamp": Field("frame,camera", "s", "float64"),
        "check_name": Field("check", "text", TEXT),
        "check_camera": Field("check", "text", LONG_TEXT),
        "check_figure": Field("check", "see check_unit", "float64", nan=True),
        "check_unit": Field("check", "text", TEXT),
        "check_threshold": Field("check", "see check_unit", "float64"),
        "check_verdict": Field("check", "text", TEXT),
        "check_text": Field("check", "text", LONG_TEXT),
        "check_cause": Field("check", "text", LONG_TEXT),
        "check_remedy": Field("check", "text", LONG_TEXT),
    },
    "hands": {
        "landmarks": Field("frame,camera,landmark,xy", "px", "float32", nan=True),
        "seen": Field("frame,camera", "1", "bool"),
        "keypoints": Field("frame,landmark,xyz", "m", "float32", nan=True),
        "end_effector": Field("frame,xyz", "m", "float32", nan=True),
        "observed": Field("frame", "1", "bool"),
        "source": Field("frame", "0 hand, 1 file, 2 what comes in", "uint8", optional=True),
        "opening": _OPENING,
        "time": _TIME,
    },
    "masks": {
        "mask": Field("mask_byte", "encoded image", "uint8"),
        "mask_offsets": Field("image_edge", "byte", "int64", ends="mask"),
        "area": Field("frame,camera", "px", "int64", low=0, high=1e9),
        "time": _TIME,
    },
    "clouds": {
        "points": Field("point,xyz", "m", "float32"),
        "offsets": Field("frame_edge", "1", "int64", ends="points"),
        "mode": Field("frame", "0 push, 1 pick", "uint8", optional=True),
        **_HAND_PATH,
    },
    "tracks": {
        "positions": Field("frame,particle,xyz", "m", "float32"),
        "residual": Field("frame", "m", "float32", nan=True, low=0),
        "visibility": Field("frame,particle", "1", "float32", low=0, high=1),
        "trust/*": Field("frame", "m", "float32", low=0),
        "mode": Field("frame", "0 push, 1 pick", "uint8"),
        **_HAND_PATH,
    },
    "scores": {
        "score_name": Field("score", "text", TEXT),
        "score_value": Field("score", "see score_name", "float64", nan=True),
        "true_positions": Field("true_frame,particle,xyz", "m", "float32"),
    },
    "dataset": {
        "positions": Field("frame,particle,xyz", "m", "float32"),
        "seen": Field("frame,particle", "1", "bool"),
        "end_effector": Field("frame,xy", "m", "float32"),
        "strokes": Field("stroke,first_last", "frame", "int64", index="frame"),
        "stroke_sequence": Field("stroke", "sequence", "int64", index="sequence"),
        "stroke_mode": Field("stroke", "0 push, 1 pick", "uint8"),
        "stroke_follows": Field("stroke", "1", "bool"),
        "pairs": Field("pair,first_last", "frame", "int64", index="frame"),
        "pair_stroke": Field("pair", "stroke", "int64", index="stroke"),
        "sequence_name": Field("sequence", "text", TEXT),
        "sequence_start": Field("sequence", "frame", "int64", index="frame"),
        "sequence_split": Field("sequence", "0 train, 1 validation, 2 test", "uint8"),
    },
    "model": {
        "weights/*": Field("*", "1", "float32"),
        "particles": Field("", "1", "int64", low=1, high=100_000),
        "modes": Field("mode", "0 push, 1 pick", "uint8"),
        "pace": Field("", "m a frame", "float64"),
        "rest": Field("rest_particle,xyz", "m", "float32"),
        "size": Field("least_most,measure", "m", "float64"),
        "step": Field("record", "1", "int64", low=0, high=INF),
        "train_loss": Field("record", "the model's own", "float64"),
        "validation_loss": Field("record", "the model's own", "float64", nan=True),
        "static_loss": Field("", "the model's own", "float64", low=0, high=INF, optional=True),
        "prior_simulator": Field("simulator", "text", TEXT, optional=True),
    },
    "prior": {
        "weights/*": Field("*", "1", "float32"),
        "step": Field("record", "1", "int64", low=1, high=INF),
        "loss": Field("record", "1", "float64", low=0, high=INF),
    },
    "checkpoint": {"state/*": Field("*", "1", "*", nan=True)},
    "metrics": {
        "horizon": Field("row", "stroke", "int64", low=1, high=INF),
        "sequence": Field("row", "text", TEXT),
        "first_stroke": Field("row", "stroke", "int64", low=0, high=INF),
        "cd": Field("row", "cm", "float64", low=0),
        "s": Field("row", "cm^2", "float64"),
        "pd": Field("row", "cm", "float64", low=0),
        "pd_truth": Field("row", "cm", "float64", nan=True),
        "motion": Field("row", "cm", "float64", low=0),
        "correction": Field("row", "cm", "float64", low=0),
    },
    "plan": {
        "goal": Field("episode,goal_point,xyz", "m", "float32"),
        "metric": Field("episode", "text", TEXT),
        "episode": Field("step", "episode", "int64", index="episode"),
        **_STEPS,
        "true_distance": Field("step", "m", "float64", low=0, optional=True),
        "path": Field("step,way_point,xyz", "m", "float32", nan=True),
        "path_time": Field("step,way_point", "s", "float64", nan=True),
        "path_closed": Field("step,way_point", "1", "bool"),
        "seed": Field("episode", "1", "int64"),
        "start_distance": Field("episode", "m", "float64", low=0, high=INF),
        "end_distance": Field("episode", "m", "float64", nan=True, low=0, high=INF),
        "ending": Field("episode", "text", TEXT),
    },
    "trials": {
        "goal": Field("goal_point,xyz", "m", "float32"),
        **_STEPS,
        "start_distance": Field("", "m", "float64", low=0, high=INF),
        "end_distance": Field("", "m", "float64", low=0, high=INF),
        "ending": Field("", "text", TEXT),
        "pd": Field("state", "m", "float64", low=0),
        "cd": Field("state", "m", "float64", low=0),
    },
    "truth": {
        "particles": Field("frame,material_point,xyz", "m", "float32"),
        "object_mask": Field("object_mask_byte", "encoded image", "uint8"),
        "object_mask_offsets": Field("image_edge", "byte", "int64", ends="object_mask"),
        "hand_mask": Field("hand_mask_byte", "encoded image", "uint8"),
        "hand_mask_offsets": Field("image_edge", "byte", "int64", ends="hand_mask"),
        "hand_keypoints": Field("frame,landmark,xyz", "m", "float32", nan=True),
        "vertices": Field("frame,vertex,xyz", "m", "float32"),
        "triangles": Field("triangle,3", "vertex", "int64", index="vertex"),
        "stroke": Field("frame", "stroke, -1 none", "int64"),
        "pose/*": Field("camera,4,4", "m", "float64", pose=True),
        "done/*": Field("frame,camera", "1", "bool"),
        **_HAND_PATH,
    },
}


def field_of(artifact: str, dataset: str) -> Field | None:
    """The field of a dataset, with `group/*` patterns resolved, or None when the artifact has no such dataset."""
    fields = SCHEMAS[artifact]
    return fields.get(dataset) or fields.get(dataset.split("/")[0] + "/*")
