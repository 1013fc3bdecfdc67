"""Messages as REST shows them: equal to the message."""

import json
from typing import Any

import pytest
from google.protobuf.json_format import MessageToDict
from google.protobuf.message import Message
from hypothesis import given, settings
from hypothesis import strategies as st
from lambent_proto.v1 import bundle_pb2, capture_pb2, evaluation_pb2, job_pb2, scene_pb2
from lambent_server.api import messages
from lambent_server.api.rest_json import enum_text, to_rest
from lambent_server.app import describe

MIRRORED = [
    (job_pb2.Progress, messages.Progress),
    (job_pb2.Event, messages.Event),
    (scene_pb2.Finding, messages.Finding),
    (scene_pb2.SceneReport, messages.SceneReport),
    (capture_pb2.PictureFigures, messages.PictureFigures),
    (capture_pb2.ViewFigures, messages.ViewFigures),
    (capture_pb2.CaptureFigures, messages.CaptureFigures),
]
ALL = [
    *(message for message, _ in MIRRORED),
    job_pb2.CheckpointManifest,
    scene_pb2.SceneManifest,
    bundle_pb2.BundleManifest,
    evaluation_pb2.EvaluationReport,
]

TEXT = st.text(max_size=8)
NUMBERS = {
    "double": st.floats(allow_nan=False, allow_infinity=False),
    "uint32": st.integers(0, 2**32 - 1),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "bool": st.booleans(),
    "string": TEXT,
}
KINDS = {1: "double", 13: "uint32", 5: "int32", 8: "bool", 9: "string"}


def values(field: Any) -> st.SearchStrategy[Any]:
    """Return values that a field can have."""
    if field.message_type is not None:
        return any_message(field.message_type._concrete_class)
    if field.enum_type is not None:
        return st.sampled_from([value.number for value in field.enum_type.values])
    return NUMBERS[KINDS[field.type]]


@st.composite
def any_message(draw: Any, kind: type[Message]) -> Message:
    """Return a message with any of its fields set."""
    given_values = {}
    for field in kind.DESCRIPTOR.fields:
        if not draw(st.booleans()):
            continue
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            inner = field.message_type.fields_by_name["value"]
            given_values[field.name] = draw(st.dictionaries(TEXT, values(inner), max_size=2))
        elif field.is_repeated:
            given_values[field.name] = draw(st.lists(values(field), max_size=2))
        else:
            given_values[field.name] = draw(values(field))
    return kind(**given_values)


@pytest.mark.parametrize("kind", ALL)
def test_the_rest_object_is_protojson_but_for_enumerations_and_unset_messages(kind: type[Message]):
    def compare(shown: Any, proto: Any) -> None:
        if isinstance(shown, dict):
            for name, value in shown.items():
                if value is None:
                    assert name not in proto
                else:
                    compare(value, proto[name])
            assert set(proto) <= set(shown)
        elif isinstance(shown, list):
            assert len(shown) == len(proto)
            for mine, theirs in zip(shown, proto, strict=True):
                compare(mine, theirs)
        elif isinstance(proto, str) and proto != shown:
            assert proto.endswith((shown.upper(), "_UNSPECIFIED"))
        else:
            assert shown == proto

    @settings(max_examples=25, deadline=None)
    @given(any_message(kind))
    def check(message: Message) -> None:
        options = {"preserving_proto_field_name": True, "always_print_fields_with_no_presence": True}
        compare(to_rest(message), MessageToDict(message, **options))

    check()


@pytest.mark.parametrize(("kind", "model"), MIRRORED)
def test_a_rest_model_takes_its_message_and_gives_it_back(kind: type[Message], model: type[Any]):
    @settings(max_examples=25, deadline=None)
    @given(any_message(kind))
    def check(message: Message) -> None:
        shown = to_rest(message)
        assert model(**shown).model_dump() == shown

    check()
    assert list(model.model_fields) == [field.name for field in kind.DESCRIPTOR.fields]


def test_enumerations_are_words():
    assert enum_text(job_pb2.JobState, job_pb2.JOB_STATE_RETRY_WAIT) == "retry_wait"
    assert enum_text(scene_pb2.Severity, 0) == ""


def test_sizes_are_integers():
    manifest = bundle_pb2.BundleManifest(files=[{"path": "a", "size_bytes": 3084.0}])
    assert '"size_bytes": 3084,' in json.dumps(to_rest(manifest))


def test_every_size_that_the_interface_shows_is_an_integer():
    """Programs in languages with a type for integers read what is described as one."""
    schemas = describe()["components"]["schemas"]
    sizes = [
        (name, field, shown)
        for name, schema in schemas.items()
        for field, shown in schema.get("properties", {}).items()
        if field.endswith("_bytes") or field in ("size", "offset")
    ]
    assert len(sizes) >= 10
    assert [each for each in sizes if each[2].get("type") != "integer"] == []
