"""Bodies of the REST interface for pictures."""

from typing import Annotated, Any

from lambent_core.pictures import (
    WHOLE,
    Angle,
    Identifier,
    RenderAsset,
    RenderCameras,
    RenderEnvironment,
    RenderMaterial,
    RenderOutput,
    RenderQuality,
    RenderSpec,
)
from pydantic import Field

from lambent_server.api.messages import ONLY_THESE, Artifact, Given, JobState, LabelName, Shown
from lambent_server.api.parameters import SettingValue


class _Order(Given):
    priority: Annotated[int, Field(ge=-1000, le=1000), WHOLE] = 0
    labels: Annotated[
        dict[LabelName, SettingValue],
        Field(max_length=32, json_schema_extra=ONLY_THESE, default_factory=dict),
    ]


class NewBatch(RenderSpec, _Order):
    """A batch to queue."""

    shards: Annotated[int, Field(ge=0, le=64), WHOLE] = 0
    """Number of jobs that render it; 0: as many as run at the same time."""

    @property
    def spec(self) -> dict[str, Any]:
        """Return the fields of the order itself, as it is kept."""
        return self.model_dump(mode="json", include=set(RenderSpec.model_fields))


class NewRender(_Order):
    """Pictures of one bundle to queue."""

    bundle_id: Identifier
    environments: Annotated[list[RenderEnvironment], Field(min_length=1, max_length=100)]
    cameras: RenderCameras
    quality: Annotated[RenderQuality, Field(default_factory=RenderQuality)]
    material: Annotated[RenderMaterial, Field(default_factory=RenderMaterial)]
    object_rotate_deg: Angle = 0.0
    output: Annotated[RenderOutput, Field(default_factory=RenderOutput)]

    def as_batch(self) -> NewBatch:
        """Return the same pictures as a batch of one job."""
        asset = RenderAsset(
            bundle_id=self.bundle_id, material=self.material, object_rotate_deg=self.object_rotate_deg
        )
        return NewBatch(
            name="render",
            assets=[asset],
            environments=self.environments,
            cameras=[self.cameras],
            qualities=[self.quality],
            output=self.output,
            shards=1,
            priority=self.priority,
            labels=self.labels,
        )


class Batch(Shown):
    """A batch and its progress."""

    id: str
    name: str
    state: JobState
    """The combined state of its jobs: final when all are, `succeeded` when all have."""
    created_at: str
    num_pictures: int
    num_done: int
    """Pictures that were rendered, or could not be."""
    num_failed: int
    """Pictures that could not be rendered; a `finding` among the events says why."""
    job_ids: list[str]
    """One job for each part of the batch, the newest if a part was retried. After several parts comes
    the job that creates their table and contact sheet."""


class BatchList(Shown):
    """One page of batches, newest first."""

    items: list[Batch]
    next_cursor: str | None


class BatchArtifact(Artifact):
    """A file that one of the jobs of a batch has produced."""

    job_id: str


class BatchArtifactList(Shown):
    """The files of a batch, by name."""

    items: list[BatchArtifact]
    next_cursor: str | None
