"""Bodies of the REST interface about pictures; what mirrors a message of `proto/` has its fields."""

from typing import Annotated, Literal, get_args

from pydantic import Field

from lambent_server.messages import (
    ONLY_THESE,
    WHOLE,
    Artifact,
    Given,
    JobState,
    LabelName,
    Name,
    SettingValue,
    Shown,
)

PictureName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9._-]{0,63}$")]
Identifier = Annotated[str, Field(pattern="^[a-z0-9_]{1,64}$")]
Angle = Annotated[float, Field(ge=-36000.0, le=36000.0)]
Side = Annotated[int, Field(ge=0, le=16384), WHOLE]
Finite = Annotated[float, Field(ge=-1e9, le=1e9)]
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
Axes = Literal["blender", "threejs", "mitsuba", "skylibs"]
Pass = Literal[
    "direct",
    "indirect",
    "diffuse",
    "specular",
    "standard_error",
    "visibility",
    "albedo",
    "normal",
    "perceptual_roughness",
    "metalness",
    "depth",
]


class RenderMaterial(Given):
    """What differs from the bundle's material; mirrors lambent_proto.v1.RenderMaterial."""

    albedo_gain: Annotated[
        list[Positive], Field(min_length=3, max_length=3, default_factory=lambda: [1.0, 1.0, 1.0])
    ]
    albedo: (
        Annotated[list[Annotated[float, Field(ge=0.0, le=1.0)]], Field(min_length=3, max_length=3)] | None
    ) = None
    roughness_scale: Annotated[float, Field(ge=0.0, le=1e6)] = 1.0


class RenderAsset(Given):
    """A bundle in one material and pose; mirrors lambent_proto.v1.RenderAsset."""

    name: PictureName | None = None
    """The bundle's id where it is not given."""
    bundle_id: Identifier
    material: Annotated[RenderMaterial, Field(default_factory=RenderMaterial)]
    object_rotate_deg: Angle = 0.0


class RenderEnvironment(Given):
    """An environment and how it is to be used; mirrors lambent_proto.v1.RenderEnvironment."""

    name: PictureName | None = None
    """The environment's own where it is not given."""
    environment_id: Identifier
    axes: Axes = "blender"
    mend: bool = False
    sun_clamp: Annotated[float, Field(ge=0.0, le=1e30)] = 0.0
    rotate_deg: Angle = 0.0


class RenderCamera(Given):
    """A pinhole camera; mirrors lambent_proto.v1.RenderCamera."""

    name: Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
    width: Annotated[int, Field(ge=1, le=16384), WHOLE]
    height: Annotated[int, Field(ge=1, le=16384), WHOLE]
    focal_x: Annotated[float, Field(gt=0.0, le=1e9)]
    focal_y: Annotated[float, Field(gt=0.0, le=1e9)]
    centre_x: Finite
    centre_y: Finite
    camera_to_world: Annotated[list[Finite], Field(min_length=16, max_length=16)]


class RenderCameras(Given):
    """Some cameras: one of turntable, views, all_views and poses; mirrors lambent_proto.v1.RenderCameras."""

    name: Annotated[str, Field(pattern=r"^([A-Za-z0-9_][A-Za-z0-9._-]{0,63})?$")] = ""
    turntable: Annotated[int, Field(ge=0, le=1000), WHOLE] = 0
    elevation_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    radius: Positive | None = None
    field_of_view_deg: Annotated[float, Field(ge=0.1, le=179.0)] | None = None
    start_deg: Angle = 0.0
    views: Annotated[
        list[Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]],
        Field(max_length=1000, default_factory=list),
    ]
    all_views: bool = False
    poses: Annotated[list[RenderCamera], Field(max_length=1000, default_factory=list)]
    size: Side = 0


class RenderQuality(Given):
    """How pictures are made; mirrors lambent_proto.v1.RenderQuality."""

    name: PictureName | None = None
    """The quality itself where it is not given."""
    quality: Literal["preview", "baked", "refined"] = "refined"
    spp: Annotated[int, Field(ge=2, le=65536), WHOLE] = 64
    until_stderr: Annotated[float, Field(ge=0.0, le=0.999)] = 0.0
    antialias: Annotated[int, Field(ge=1, le=8), WHOLE] = 2
    indirect: bool = True
    bounces: Literal["auto", "adapted", "transport", "one"] = "auto"
    seed: Annotated[int, Field(ge=0, le=2**31 - 1), WHOLE] = 0
    background: Literal["transparent", "environment", "white"] = "transparent"
    exposure_ev: Annotated[float, Field(ge=-64.0, le=64.0)] = 0.0
    tone_mapping: Literal["linear", "neutral", "aces", "agx"] = "linear"


_PLACE = r"\{(?:asset|environment|quality|camera)\}"
_PART = rf"(?:[A-Za-z0-9_]|{_PLACE})(?:[A-Za-z0-9._-]|{_PLACE})*"


class RenderOutput(Given):
    """What is written of every picture; mirrors lambent_proto.v1.RenderOutput."""

    files: Annotated[
        list[Literal["png", "exr"]],
        Field(min_length=1, max_length=2, default_factory=lambda: ["png", "exr"]),
    ]
    passes: Annotated[list[Pass], Field(max_length=11, default_factory=lambda: list(get_args(Pass)))]
    half: bool = True
    path: Annotated[str, Field(max_length=300, pattern=rf"^{_PART}(?:/{_PART})*$")] = (
        "{asset}/{environment}/{quality}/{camera}"
    )
    """Path of a picture without suffix."""


class RenderSpec(Given):
    """Assets x environments x cameras x qualities; mirrors lambent_proto.v1.RenderSpec."""

    name: Name = "batch"
    assets: Annotated[list[RenderAsset], Field(min_length=1, max_length=1000)]
    environments: Annotated[list[RenderEnvironment], Field(min_length=1, max_length=1000)]
    cameras: Annotated[list[RenderCameras], Field(min_length=1, max_length=100)]
    qualities: Annotated[
        list[RenderQuality], Field(min_length=1, max_length=16, default_factory=lambda: [RenderQuality()])
    ]
    output: Annotated[RenderOutput, Field(default_factory=RenderOutput)]


class _Order(Given):
    priority: Annotated[int, Field(ge=-1000, le=1000), WHOLE] = 0
    labels: Annotated[
        dict[LabelName, SettingValue],
        Field(max_length=32, json_schema_extra=ONLY_THESE, default_factory=dict),
    ]


class NewBatch(RenderSpec, _Order):
    """A batch to queue."""

    shards: Annotated[int, Field(ge=0, le=64), WHOLE] = 0
    """Jobs it is split into; 0: as many as run at the same time."""


class NewRender(_Order):
    """Pictures of one bundle to queue."""

    bundle_id: Identifier
    environments: Annotated[list[RenderEnvironment], Field(min_length=1, max_length=100)]
    cameras: RenderCameras
    quality: Annotated[RenderQuality, Field(default_factory=RenderQuality)]
    material: Annotated[RenderMaterial, Field(default_factory=RenderMaterial)]
    object_rotate_deg: Angle = 0.0
    output: Annotated[RenderOutput, Field(default_factory=RenderOutput)]


class Batch(Shown):
    """A batch and how far it is."""

    id: str
    name: str
    state: JobState
    """That of its jobs together: final when all are, `succeeded` when all have."""
    created_at: str
    num_pictures: int
    num_done: int
    """Pictures that were made, or found that they cannot be."""
    num_failed: int
    """Pictures that cannot be made; a `finding` among the events says why."""
    job_ids: list[str]
    """One job for each part of the batch, the newest where a part was tried again. Behind several parts comes
    the job that makes their table and contact sheet."""


class BatchList(Shown):
    """One page of batches, the newest first."""

    items: list[Batch]
    next_cursor: str | None


class BatchArtifact(Artifact):
    """A file that one of the jobs of a batch has made."""

    job_id: str


class BatchArtifactList(Shown):
    """The files of a batch, by name."""

    items: list[BatchArtifact]
