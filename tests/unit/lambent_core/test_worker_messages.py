"""Messages as JSON: whole sizes, and everything that a message holds."""

import json

from google.protobuf import json_format
from lambent_core.messages import message_to_dict
from lambent_proto.v1 import bundle_pb2


def test_sizes_are_integers_in_json_and_read_back_as_they_were():
    """A parser with a type of integers refuses 3084.0, and one without reads 2^53 - 1 exactly."""
    manifest = bundle_pb2.BundleManifest(
        files=[{"path": "a", "size_bytes": 3084.0}, {"size_bytes": 2**53 - 1}]
    )
    text = json.dumps(message_to_dict(manifest))
    assert '"size_bytes": 3084,' in text
    assert '"size_bytes": 9007199254740991,' in text
    assert json_format.Parse(text, bundle_pb2.BundleManifest()) == manifest


def test_all_sizes_in_the_files_of_a_bundle_are_integers():
    sizes = [
        (kind._concrete_class, field.name)
        for kind in bundle_pb2.DESCRIPTOR.message_types_by_name.values()
        for field in kind.fields
        if field.name.endswith("_bytes")
    ]
    assert len(sizes) >= 3
    for kind, name in sizes:
        assert type(message_to_dict(kind(**{name: 8.0}))[name]) is int, (kind, name)
