"""Rows of tables that rooms below their own read too; a test compares them with the tables."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True, slots=True)
class JobRow:
    """A row of `jobs`. Times are Unix seconds."""

    id: str
    tenant_id: str
    kind: str
    scene_id: str
    preset: str
    params: dict[str, Any]
    gpus: int
    priority: int
    labels: dict[str, str]
    seed: int
    state: str
    run: int
    """The fence: counts the starts."""
    created_at: float
    updated_at: float
    started_at: float | None
    finished_at: float | None
    progress: dict[str, Any] | None
    error: dict[str, Any] | None
    bundle_id: str | None
    failures: int
    losses: int
    losses_without_checkpoint: int
    adjustments: dict[str, dict[str, float]]
    """What the next run does differently: factors by stage and setting."""
    retry_at: float | None
    stop_reason: str | None
    stop_at: float | None
    handle: dict[str, Any] | None
    """The executor's handle of the process; None if it has none."""
    run_started_at: float | None
    heartbeat_at: float | None
    progress_at: float | None
    progress_event_at: float | None
    event_seq: int
    report_seq: int
    order_id: str | None
    shard: int | None
    preview_sha256: str | None
    webhook: str | None
    maker_user_id: str | None
    maker_key_id: str | None
    gpu_s_reserved: float | None

    @property
    def part(self) -> tuple[str, int]:
        """The order of pictures and the part of it that the job renders; jobs of other kinds have none."""
        assert self.order_id is not None
        assert self.shard is not None
        return self.order_id, self.shard
