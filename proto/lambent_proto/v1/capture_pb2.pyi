from lambent_proto.v1 import scene_pb2 as _scene_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CaptureFigures(_message.Message):
    __slots__ = ("schema_version", "num_train_views", "gap_deg", "upper_gap_deg", "upper_gap_azimuth_deg", "upper_gap_elevation_deg", "lowest_elevation_deg", "highest_elevation_deg", "has_masks", "has_hull", "outside_box_share", "exposure_range_ev", "views", "lacks_cameras")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    NUM_TRAIN_VIEWS_FIELD_NUMBER: _ClassVar[int]
    GAP_DEG_FIELD_NUMBER: _ClassVar[int]
    UPPER_GAP_DEG_FIELD_NUMBER: _ClassVar[int]
    UPPER_GAP_AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    UPPER_GAP_ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    LOWEST_ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    HIGHEST_ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    HAS_MASKS_FIELD_NUMBER: _ClassVar[int]
    HAS_HULL_FIELD_NUMBER: _ClassVar[int]
    OUTSIDE_BOX_SHARE_FIELD_NUMBER: _ClassVar[int]
    EXPOSURE_RANGE_EV_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    LACKS_CAMERAS_FIELD_NUMBER: _ClassVar[int]
    schema_version: str
    num_train_views: int
    gap_deg: float
    upper_gap_deg: float
    upper_gap_azimuth_deg: float
    upper_gap_elevation_deg: float
    lowest_elevation_deg: float
    highest_elevation_deg: float
    has_masks: bool
    has_hull: bool
    outside_box_share: float
    exposure_range_ev: float
    views: _containers.RepeatedCompositeFieldContainer[ViewFigures]
    lacks_cameras: bool
    def __init__(self, schema_version: _Optional[str] = ..., num_train_views: _Optional[int] = ..., gap_deg: _Optional[float] = ..., upper_gap_deg: _Optional[float] = ..., upper_gap_azimuth_deg: _Optional[float] = ..., upper_gap_elevation_deg: _Optional[float] = ..., lowest_elevation_deg: _Optional[float] = ..., highest_elevation_deg: _Optional[float] = ..., has_masks: _Optional[bool] = ..., has_hull: _Optional[bool] = ..., outside_box_share: _Optional[float] = ..., exposure_range_ev: _Optional[float] = ..., views: _Optional[_Iterable[_Union[ViewFigures, _Mapping]]] = ..., lacks_cameras: _Optional[bool] = ...) -> None: ...

class ViewFigures(_message.Message):
    __slots__ = ("name", "split", "azimuth_deg", "elevation_deg", "distance", "mask_share", "border_share", "unexplained_share", "missed_share", "carved_share", "hole_share", "speck_share", "num_specks", "moved_share", "mismatch_ev", "pictures")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SPLIT_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_FIELD_NUMBER: _ClassVar[int]
    MASK_SHARE_FIELD_NUMBER: _ClassVar[int]
    BORDER_SHARE_FIELD_NUMBER: _ClassVar[int]
    UNEXPLAINED_SHARE_FIELD_NUMBER: _ClassVar[int]
    MISSED_SHARE_FIELD_NUMBER: _ClassVar[int]
    CARVED_SHARE_FIELD_NUMBER: _ClassVar[int]
    HOLE_SHARE_FIELD_NUMBER: _ClassVar[int]
    SPECK_SHARE_FIELD_NUMBER: _ClassVar[int]
    NUM_SPECKS_FIELD_NUMBER: _ClassVar[int]
    MOVED_SHARE_FIELD_NUMBER: _ClassVar[int]
    MISMATCH_EV_FIELD_NUMBER: _ClassVar[int]
    PICTURES_FIELD_NUMBER: _ClassVar[int]
    name: str
    split: _scene_pb2.Split
    azimuth_deg: float
    elevation_deg: float
    distance: float
    mask_share: float
    border_share: float
    unexplained_share: float
    missed_share: float
    carved_share: float
    hole_share: float
    speck_share: float
    num_specks: int
    moved_share: float
    mismatch_ev: float
    pictures: _containers.RepeatedCompositeFieldContainer[PictureFigures]
    def __init__(self, name: _Optional[str] = ..., split: _Optional[_Union[_scene_pb2.Split, str]] = ..., azimuth_deg: _Optional[float] = ..., elevation_deg: _Optional[float] = ..., distance: _Optional[float] = ..., mask_share: _Optional[float] = ..., border_share: _Optional[float] = ..., unexplained_share: _Optional[float] = ..., missed_share: _Optional[float] = ..., carved_share: _Optional[float] = ..., hole_share: _Optional[float] = ..., speck_share: _Optional[float] = ..., num_specks: _Optional[int] = ..., moved_share: _Optional[float] = ..., mismatch_ev: _Optional[float] = ..., pictures: _Optional[_Iterable[_Union[PictureFigures, _Mapping]]] = ...) -> None: ...

class PictureFigures(_message.Message):
    __slots__ = ("light", "path", "clipped_share", "sharpness", "exposure_ev", "exposure_jump_ev")
    LIGHT_FIELD_NUMBER: _ClassVar[int]
    PATH_FIELD_NUMBER: _ClassVar[int]
    CLIPPED_SHARE_FIELD_NUMBER: _ClassVar[int]
    SHARPNESS_FIELD_NUMBER: _ClassVar[int]
    EXPOSURE_EV_FIELD_NUMBER: _ClassVar[int]
    EXPOSURE_JUMP_EV_FIELD_NUMBER: _ClassVar[int]
    light: str
    path: str
    clipped_share: float
    sharpness: float
    exposure_ev: float
    exposure_jump_ev: float
    def __init__(self, light: _Optional[str] = ..., path: _Optional[str] = ..., clipped_share: _Optional[float] = ..., sharpness: _Optional[float] = ..., exposure_ev: _Optional[float] = ..., exposure_jump_ev: _Optional[float] = ...) -> None: ...
