from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Split(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SPLIT_UNSPECIFIED: _ClassVar[Split]
    SPLIT_TRAIN: _ClassVar[Split]
    SPLIT_TEST: _ClassVar[Split]

class Severity(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SEVERITY_UNSPECIFIED: _ClassVar[Severity]
    SEVERITY_WARNING: _ClassVar[Severity]
    SEVERITY_ERROR: _ClassVar[Severity]
SPLIT_UNSPECIFIED: Split
SPLIT_TRAIN: Split
SPLIT_TEST: Split
SEVERITY_UNSPECIFIED: Severity
SEVERITY_WARNING: Severity
SEVERITY_ERROR: Severity

class SceneManifest(_message.Message):
    __slots__ = ("schema_version", "name", "layout", "lights", "frames", "bounds", "primary_rays", "secondary_rays", "contraction_radius", "relight_lights", "world_from_capture", "bounds_from", "light_fixed_to", "light_frame")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    LAYOUT_FIELD_NUMBER: _ClassVar[int]
    LIGHTS_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    BOUNDS_FIELD_NUMBER: _ClassVar[int]
    PRIMARY_RAYS_FIELD_NUMBER: _ClassVar[int]
    SECONDARY_RAYS_FIELD_NUMBER: _ClassVar[int]
    CONTRACTION_RADIUS_FIELD_NUMBER: _ClassVar[int]
    RELIGHT_LIGHTS_FIELD_NUMBER: _ClassVar[int]
    WORLD_FROM_CAPTURE_FIELD_NUMBER: _ClassVar[int]
    BOUNDS_FROM_FIELD_NUMBER: _ClassVar[int]
    LIGHT_FIXED_TO_FIELD_NUMBER: _ClassVar[int]
    LIGHT_FRAME_FIELD_NUMBER: _ClassVar[int]
    schema_version: str
    name: str
    layout: str
    lights: _containers.RepeatedScalarFieldContainer[str]
    frames: _containers.RepeatedCompositeFieldContainer[Frame]
    bounds: Bounds
    primary_rays: RayRange
    secondary_rays: RayRange
    contraction_radius: float
    relight_lights: _containers.RepeatedScalarFieldContainer[str]
    world_from_capture: _containers.RepeatedScalarFieldContainer[float]
    bounds_from: str
    light_fixed_to: str
    light_frame: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, schema_version: _Optional[str] = ..., name: _Optional[str] = ..., layout: _Optional[str] = ..., lights: _Optional[_Iterable[str]] = ..., frames: _Optional[_Iterable[_Union[Frame, _Mapping]]] = ..., bounds: _Optional[_Union[Bounds, _Mapping]] = ..., primary_rays: _Optional[_Union[RayRange, _Mapping]] = ..., secondary_rays: _Optional[_Union[RayRange, _Mapping]] = ..., contraction_radius: _Optional[float] = ..., relight_lights: _Optional[_Iterable[str]] = ..., world_from_capture: _Optional[_Iterable[float]] = ..., bounds_from: _Optional[str] = ..., light_fixed_to: _Optional[str] = ..., light_frame: _Optional[_Iterable[float]] = ...) -> None: ...

class Bounds(_message.Message):
    __slots__ = ("minimum", "maximum")
    MINIMUM_FIELD_NUMBER: _ClassVar[int]
    MAXIMUM_FIELD_NUMBER: _ClassVar[int]
    minimum: _containers.RepeatedScalarFieldContainer[float]
    maximum: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, minimum: _Optional[_Iterable[float]] = ..., maximum: _Optional[_Iterable[float]] = ...) -> None: ...

class RayRange(_message.Message):
    __slots__ = ("near", "far")
    NEAR_FIELD_NUMBER: _ClassVar[int]
    FAR_FIELD_NUMBER: _ClassVar[int]
    near: float
    far: float
    def __init__(self, near: _Optional[float] = ..., far: _Optional[float] = ...) -> None: ...

class Frame(_message.Message):
    __slots__ = ("name", "split", "camera", "images", "truth", "mask", "exposure", "mask_encoding")
    class TruthEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    NAME_FIELD_NUMBER: _ClassVar[int]
    SPLIT_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    IMAGES_FIELD_NUMBER: _ClassVar[int]
    TRUTH_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    EXPOSURE_FIELD_NUMBER: _ClassVar[int]
    MASK_ENCODING_FIELD_NUMBER: _ClassVar[int]
    name: str
    split: Split
    camera: Camera
    images: _containers.RepeatedCompositeFieldContainer[Image]
    truth: _containers.ScalarMap[str, str]
    mask: str
    exposure: float
    mask_encoding: str
    def __init__(self, name: _Optional[str] = ..., split: _Optional[_Union[Split, str]] = ..., camera: _Optional[_Union[Camera, _Mapping]] = ..., images: _Optional[_Iterable[_Union[Image, _Mapping]]] = ..., truth: _Optional[_Mapping[str, str]] = ..., mask: _Optional[str] = ..., exposure: _Optional[float] = ..., mask_encoding: _Optional[str] = ...) -> None: ...

class Camera(_message.Message):
    __slots__ = ("width", "height", "focal_x", "focal_y", "centre_x", "centre_y", "camera_to_world", "lens")
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    FOCAL_X_FIELD_NUMBER: _ClassVar[int]
    FOCAL_Y_FIELD_NUMBER: _ClassVar[int]
    CENTRE_X_FIELD_NUMBER: _ClassVar[int]
    CENTRE_Y_FIELD_NUMBER: _ClassVar[int]
    CAMERA_TO_WORLD_FIELD_NUMBER: _ClassVar[int]
    LENS_FIELD_NUMBER: _ClassVar[int]
    width: int
    height: int
    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float
    camera_to_world: _containers.RepeatedScalarFieldContainer[float]
    lens: Lens
    def __init__(self, width: _Optional[int] = ..., height: _Optional[int] = ..., focal_x: _Optional[float] = ..., focal_y: _Optional[float] = ..., centre_x: _Optional[float] = ..., centre_y: _Optional[float] = ..., camera_to_world: _Optional[_Iterable[float]] = ..., lens: _Optional[_Union[Lens, _Mapping]] = ...) -> None: ...

class Lens(_message.Message):
    __slots__ = ("width", "height", "focal_x", "focal_y", "centre_x", "centre_y", "distortion")
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    FOCAL_X_FIELD_NUMBER: _ClassVar[int]
    FOCAL_Y_FIELD_NUMBER: _ClassVar[int]
    CENTRE_X_FIELD_NUMBER: _ClassVar[int]
    CENTRE_Y_FIELD_NUMBER: _ClassVar[int]
    DISTORTION_FIELD_NUMBER: _ClassVar[int]
    width: int
    height: int
    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float
    distortion: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, width: _Optional[int] = ..., height: _Optional[int] = ..., focal_x: _Optional[float] = ..., focal_y: _Optional[float] = ..., centre_x: _Optional[float] = ..., centre_y: _Optional[float] = ..., distortion: _Optional[_Iterable[float]] = ...) -> None: ...

class Image(_message.Message):
    __slots__ = ("light", "path", "encoding")
    LIGHT_FIELD_NUMBER: _ClassVar[int]
    PATH_FIELD_NUMBER: _ClassVar[int]
    ENCODING_FIELD_NUMBER: _ClassVar[int]
    light: str
    path: str
    encoding: str
    def __init__(self, light: _Optional[str] = ..., path: _Optional[str] = ..., encoding: _Optional[str] = ...) -> None: ...

class Finding(_message.Message):
    __slots__ = ("code", "severity", "message", "subject")
    CODE_FIELD_NUMBER: _ClassVar[int]
    SEVERITY_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    code: str
    severity: Severity
    message: str
    subject: str
    def __init__(self, code: _Optional[str] = ..., severity: _Optional[_Union[Severity, str]] = ..., message: _Optional[str] = ..., subject: _Optional[str] = ...) -> None: ...

class SceneReport(_message.Message):
    __slots__ = ("usable", "layout", "findings", "num_train_frames", "num_test_frames")
    USABLE_FIELD_NUMBER: _ClassVar[int]
    LAYOUT_FIELD_NUMBER: _ClassVar[int]
    FINDINGS_FIELD_NUMBER: _ClassVar[int]
    NUM_TRAIN_FRAMES_FIELD_NUMBER: _ClassVar[int]
    NUM_TEST_FRAMES_FIELD_NUMBER: _ClassVar[int]
    usable: bool
    layout: str
    findings: _containers.RepeatedCompositeFieldContainer[Finding]
    num_train_frames: int
    num_test_frames: int
    def __init__(self, usable: _Optional[bool] = ..., layout: _Optional[str] = ..., findings: _Optional[_Iterable[_Union[Finding, _Mapping]]] = ..., num_train_frames: _Optional[int] = ..., num_test_frames: _Optional[int] = ...) -> None: ...
