from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class RenderTask(_message.Message):
    __slots__ = ("spec", "shard", "num_shards", "failures")
    SPEC_FIELD_NUMBER: _ClassVar[int]
    SHARD_FIELD_NUMBER: _ClassVar[int]
    NUM_SHARDS_FIELD_NUMBER: _ClassVar[int]
    FAILURES_FIELD_NUMBER: _ClassVar[int]
    spec: str
    shard: int
    num_shards: int
    failures: _containers.RepeatedCompositeFieldContainer[RenderFailure]
    def __init__(self, spec: _Optional[str] = ..., shard: _Optional[int] = ..., num_shards: _Optional[int] = ..., failures: _Optional[_Iterable[_Union[RenderFailure, _Mapping]]] = ...) -> None: ...

class RenderFailure(_message.Message):
    __slots__ = ("path", "code", "message")
    PATH_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    path: str
    code: str
    message: str
    def __init__(self, path: _Optional[str] = ..., code: _Optional[str] = ..., message: _Optional[str] = ...) -> None: ...
