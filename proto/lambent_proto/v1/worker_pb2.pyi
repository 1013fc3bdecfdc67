from lambent_proto.v1 import capture_pb2 as _capture_pb2
from lambent_proto.v1 import job_pb2 as _job_pb2
from lambent_proto.v1 import render_pb2 as _render_pb2
from lambent_proto.v1 import scene_pb2 as _scene_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Outcome(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OUTCOME_UNSPECIFIED: _ClassVar[Outcome]
    OUTCOME_SUCCEEDED: _ClassVar[Outcome]
    OUTCOME_STOPPED: _ClassVar[Outcome]

class FailCause(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FAIL_CAUSE_UNSPECIFIED: _ClassVar[FailCause]
    FAIL_CAUSE_INTERNAL: _ClassVar[FailCause]
    FAIL_CAUSE_BAD_SCENE: _ClassVar[FailCause]
    FAIL_CAUSE_BAD_CONFIG: _ClassVar[FailCause]
    FAIL_CAUSE_OUT_OF_MEMORY: _ClassVar[FailCause]
    FAIL_CAUSE_GPU_OUT_OF_MEMORY: _ClassVar[FailCause]
    FAIL_CAUSE_DIVERGED: _ClassVar[FailCause]
    FAIL_CAUSE_KILLED: _ClassVar[FailCause]
OUTCOME_UNSPECIFIED: Outcome
OUTCOME_SUCCEEDED: Outcome
OUTCOME_STOPPED: Outcome
FAIL_CAUSE_UNSPECIFIED: FailCause
FAIL_CAUSE_INTERNAL: FailCause
FAIL_CAUSE_BAD_SCENE: FailCause
FAIL_CAUSE_BAD_CONFIG: FailCause
FAIL_CAUSE_OUT_OF_MEMORY: FailCause
FAIL_CAUSE_GPU_OUT_OF_MEMORY: FailCause
FAIL_CAUSE_DIVERGED: FailCause
FAIL_CAUSE_KILLED: FailCause

class Fence(_message.Message):
    __slots__ = ("job_id", "run")
    JOB_ID_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    job_id: str
    run: int
    def __init__(self, job_id: _Optional[str] = ..., run: _Optional[int] = ...) -> None: ...

class RegisterRequest(_message.Message):
    __slots__ = ("fence", "pid", "process_identity", "host")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    PID_FIELD_NUMBER: _ClassVar[int]
    PROCESS_IDENTITY_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    pid: int
    process_identity: str
    host: str
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., pid: _Optional[int] = ..., process_identity: _Optional[str] = ..., host: _Optional[str] = ...) -> None: ...

class RegisterResponse(_message.Message):
    __slots__ = ("heartbeat_s", "servers")
    HEARTBEAT_S_FIELD_NUMBER: _ClassVar[int]
    SERVERS_FIELD_NUMBER: _ClassVar[int]
    heartbeat_s: float
    servers: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, heartbeat_s: _Optional[float] = ..., servers: _Optional[_Iterable[str]] = ...) -> None: ...

class StartRequest(_message.Message):
    __slots__ = ("fence", "code_version")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    CODE_VERSION_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    code_version: str
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., code_version: _Optional[str] = ...) -> None: ...

class StartResponse(_message.Message):
    __slots__ = ("kind", "scene_id", "preset", "params", "gpus", "seed", "files", "checkpoints", "check_scene", "device", "adjustments", "progress_interval_s", "preview_interval_s", "scene_name", "render")
    class ParamsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    KIND_FIELD_NUMBER: _ClassVar[int]
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    PRESET_FIELD_NUMBER: _ClassVar[int]
    PARAMS_FIELD_NUMBER: _ClassVar[int]
    GPUS_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    FILES_FIELD_NUMBER: _ClassVar[int]
    CHECKPOINTS_FIELD_NUMBER: _ClassVar[int]
    CHECK_SCENE_FIELD_NUMBER: _ClassVar[int]
    DEVICE_FIELD_NUMBER: _ClassVar[int]
    ADJUSTMENTS_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_INTERVAL_S_FIELD_NUMBER: _ClassVar[int]
    PREVIEW_INTERVAL_S_FIELD_NUMBER: _ClassVar[int]
    SCENE_NAME_FIELD_NUMBER: _ClassVar[int]
    RENDER_FIELD_NUMBER: _ClassVar[int]
    kind: str
    scene_id: str
    preset: str
    params: _containers.ScalarMap[str, str]
    gpus: int
    seed: int
    files: _containers.RepeatedCompositeFieldContainer[SceneFile]
    checkpoints: _containers.RepeatedCompositeFieldContainer[_job_pb2.CheckpointManifest]
    check_scene: bool
    device: str
    adjustments: Adjustments
    progress_interval_s: float
    preview_interval_s: float
    scene_name: str
    render: _render_pb2.RenderTask
    def __init__(self, kind: _Optional[str] = ..., scene_id: _Optional[str] = ..., preset: _Optional[str] = ..., params: _Optional[_Mapping[str, str]] = ..., gpus: _Optional[int] = ..., seed: _Optional[int] = ..., files: _Optional[_Iterable[_Union[SceneFile, _Mapping]]] = ..., checkpoints: _Optional[_Iterable[_Union[_job_pb2.CheckpointManifest, _Mapping]]] = ..., check_scene: _Optional[bool] = ..., device: _Optional[str] = ..., adjustments: _Optional[_Union[Adjustments, _Mapping]] = ..., progress_interval_s: _Optional[float] = ..., preview_interval_s: _Optional[float] = ..., scene_name: _Optional[str] = ..., render: _Optional[_Union[_render_pb2.RenderTask, _Mapping]] = ...) -> None: ...

class Adjustments(_message.Message):
    __slots__ = ("stages",)
    class StagesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: StageAdjustments
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[StageAdjustments, _Mapping]] = ...) -> None: ...
    STAGES_FIELD_NUMBER: _ClassVar[int]
    stages: _containers.MessageMap[str, StageAdjustments]
    def __init__(self, stages: _Optional[_Mapping[str, StageAdjustments]] = ...) -> None: ...

class StageAdjustments(_message.Message):
    __slots__ = ("ray_chunk", "learning_rate")
    RAY_CHUNK_FIELD_NUMBER: _ClassVar[int]
    LEARNING_RATE_FIELD_NUMBER: _ClassVar[int]
    ray_chunk: float
    learning_rate: float
    def __init__(self, ray_chunk: _Optional[float] = ..., learning_rate: _Optional[float] = ...) -> None: ...

class SceneFile(_message.Message):
    __slots__ = ("path", "sha256", "size_bytes")
    PATH_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    path: str
    sha256: str
    size_bytes: float
    def __init__(self, path: _Optional[str] = ..., sha256: _Optional[str] = ..., size_bytes: _Optional[float] = ...) -> None: ...

class HeartbeatRequest(_message.Message):
    __slots__ = ("fence",)
    FENCE_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ...) -> None: ...

class HeartbeatResponse(_message.Message):
    __slots__ = ("stop", "servers")
    STOP_FIELD_NUMBER: _ClassVar[int]
    SERVERS_FIELD_NUMBER: _ClassVar[int]
    stop: bool
    servers: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, stop: _Optional[bool] = ..., servers: _Optional[_Iterable[str]] = ...) -> None: ...

class ReportRequest(_message.Message):
    __slots__ = ("fence", "sequence", "progress", "events")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    EVENTS_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    sequence: int
    progress: _job_pb2.Progress
    events: _containers.RepeatedCompositeFieldContainer[_job_pb2.Event]
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., sequence: _Optional[int] = ..., progress: _Optional[_Union[_job_pb2.Progress, _Mapping]] = ..., events: _Optional[_Iterable[_Union[_job_pb2.Event, _Mapping]]] = ...) -> None: ...

class ReportResponse(_message.Message):
    __slots__ = ("stop", "servers")
    STOP_FIELD_NUMBER: _ClassVar[int]
    SERVERS_FIELD_NUMBER: _ClassVar[int]
    stop: bool
    servers: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, stop: _Optional[bool] = ..., servers: _Optional[_Iterable[str]] = ...) -> None: ...

class ReportSceneRequest(_message.Message):
    __slots__ = ("fence", "report", "figures", "page_sha256", "thumbnail_sha256")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    REPORT_FIELD_NUMBER: _ClassVar[int]
    FIGURES_FIELD_NUMBER: _ClassVar[int]
    PAGE_SHA256_FIELD_NUMBER: _ClassVar[int]
    THUMBNAIL_SHA256_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    report: _scene_pb2.SceneReport
    figures: _capture_pb2.CaptureFigures
    page_sha256: str
    thumbnail_sha256: str
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., report: _Optional[_Union[_scene_pb2.SceneReport, _Mapping]] = ..., figures: _Optional[_Union[_capture_pb2.CaptureFigures, _Mapping]] = ..., page_sha256: _Optional[str] = ..., thumbnail_sha256: _Optional[str] = ...) -> None: ...

class ReportSceneResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class PutBlobRequest(_message.Message):
    __slots__ = ("header", "data")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    header: BlobHeader
    data: bytes
    def __init__(self, header: _Optional[_Union[BlobHeader, _Mapping]] = ..., data: _Optional[bytes] = ...) -> None: ...

class BlobHeader(_message.Message):
    __slots__ = ("fence", "sha256", "size_bytes", "media_type")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    MEDIA_TYPE_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    sha256: str
    size_bytes: float
    media_type: str
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., sha256: _Optional[str] = ..., size_bytes: _Optional[float] = ..., media_type: _Optional[str] = ...) -> None: ...

class PutBlobResponse(_message.Message):
    __slots__ = ("created",)
    CREATED_FIELD_NUMBER: _ClassVar[int]
    created: bool
    def __init__(self, created: _Optional[bool] = ...) -> None: ...

class GetBlobRequest(_message.Message):
    __slots__ = ("fence", "sha256")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    sha256: str
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., sha256: _Optional[str] = ...) -> None: ...

class GetBlobResponse(_message.Message):
    __slots__ = ("data",)
    DATA_FIELD_NUMBER: _ClassVar[int]
    data: bytes
    def __init__(self, data: _Optional[bytes] = ...) -> None: ...

class PlanUploadRequest(_message.Message):
    __slots__ = ("fence", "sha256", "size_bytes")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    sha256: str
    size_bytes: float
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., sha256: _Optional[str] = ..., size_bytes: _Optional[float] = ...) -> None: ...

class PlanUploadResponse(_message.Message):
    __slots__ = ("stored", "parts", "direct")
    STORED_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    DIRECT_FIELD_NUMBER: _ClassVar[int]
    stored: bool
    parts: _containers.RepeatedCompositeFieldContainer[UploadPart]
    direct: bool
    def __init__(self, stored: _Optional[bool] = ..., parts: _Optional[_Iterable[_Union[UploadPart, _Mapping]]] = ..., direct: _Optional[bool] = ...) -> None: ...

class UploadPart(_message.Message):
    __slots__ = ("offset", "size_bytes", "url", "headers")
    class HeadersEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    URL_FIELD_NUMBER: _ClassVar[int]
    HEADERS_FIELD_NUMBER: _ClassVar[int]
    offset: float
    size_bytes: float
    url: str
    headers: _containers.ScalarMap[str, str]
    def __init__(self, offset: _Optional[float] = ..., size_bytes: _Optional[float] = ..., url: _Optional[str] = ..., headers: _Optional[_Mapping[str, str]] = ...) -> None: ...

class CompleteUploadRequest(_message.Message):
    __slots__ = ("fence", "sha256", "size_bytes", "media_type")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    MEDIA_TYPE_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    sha256: str
    size_bytes: float
    media_type: str
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., sha256: _Optional[str] = ..., size_bytes: _Optional[float] = ..., media_type: _Optional[str] = ...) -> None: ...

class CompleteUploadResponse(_message.Message):
    __slots__ = ("missing",)
    MISSING_FIELD_NUMBER: _ClassVar[int]
    missing: bool
    def __init__(self, missing: _Optional[bool] = ...) -> None: ...

class LocateBlobRequest(_message.Message):
    __slots__ = ("fence", "sha256")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    sha256: str
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., sha256: _Optional[str] = ...) -> None: ...

class LocateBlobResponse(_message.Message):
    __slots__ = ("url",)
    URL_FIELD_NUMBER: _ClassVar[int]
    url: str
    def __init__(self, url: _Optional[str] = ...) -> None: ...

class CommitCheckpointRequest(_message.Message):
    __slots__ = ("fence", "manifest")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    MANIFEST_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    manifest: _job_pb2.CheckpointManifest
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., manifest: _Optional[_Union[_job_pb2.CheckpointManifest, _Mapping]] = ...) -> None: ...

class CommitCheckpointResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class PublishedFile(_message.Message):
    __slots__ = ("path", "sha256", "size_bytes", "media_type")
    PATH_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    MEDIA_TYPE_FIELD_NUMBER: _ClassVar[int]
    path: str
    sha256: str
    size_bytes: float
    media_type: str
    def __init__(self, path: _Optional[str] = ..., sha256: _Optional[str] = ..., size_bytes: _Optional[float] = ..., media_type: _Optional[str] = ...) -> None: ...

class PublishRequest(_message.Message):
    __slots__ = ("fence", "bundle_files", "artifacts")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    BUNDLE_FILES_FIELD_NUMBER: _ClassVar[int]
    ARTIFACTS_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    bundle_files: _containers.RepeatedCompositeFieldContainer[PublishedFile]
    artifacts: _containers.RepeatedCompositeFieldContainer[PublishedFile]
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., bundle_files: _Optional[_Iterable[_Union[PublishedFile, _Mapping]]] = ..., artifacts: _Optional[_Iterable[_Union[PublishedFile, _Mapping]]] = ...) -> None: ...

class PublishResponse(_message.Message):
    __slots__ = ("bundle_id",)
    BUNDLE_ID_FIELD_NUMBER: _ClassVar[int]
    bundle_id: str
    def __init__(self, bundle_id: _Optional[str] = ...) -> None: ...

class FinishRequest(_message.Message):
    __slots__ = ("fence", "outcome")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    OUTCOME_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    outcome: Outcome
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., outcome: _Optional[_Union[Outcome, str]] = ...) -> None: ...

class FinishResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class FailRequest(_message.Message):
    __slots__ = ("fence", "cause", "code", "message", "artifacts")
    FENCE_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    ARTIFACTS_FIELD_NUMBER: _ClassVar[int]
    fence: Fence
    cause: FailCause
    code: str
    message: str
    artifacts: _containers.RepeatedCompositeFieldContainer[PublishedFile]
    def __init__(self, fence: _Optional[_Union[Fence, _Mapping]] = ..., cause: _Optional[_Union[FailCause, str]] = ..., code: _Optional[str] = ..., message: _Optional[str] = ..., artifacts: _Optional[_Iterable[_Union[PublishedFile, _Mapping]]] = ...) -> None: ...

class FailResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...
