"""Camera pickles are read as data: arrays come out as they went in, and nothing in a file is ever run."""

import os
import pickle
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lambent_capture.layouts.pickled_arrays import MAX_BYTES, PickleRefusedError, read_pickled_data

OUTER = np.arange(12.0).reshape(3, 4)
INNER = np.eye(3, dtype=np.float32)


def read(tmp_path, data):
    path = tmp_path / "camera.pkl"
    path.write_bytes(data)
    return read_pickled_data(path)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_a_camera_reads_the_same_whatever_protocol_wrote_it(tmp_path, protocol):
    outer, inner = read(tmp_path, pickle.dumps([OUTER, INNER], protocol))
    np.testing.assert_array_equal(outer, OUTER)
    np.testing.assert_array_equal(inner, INNER)
    assert (outer.dtype, inner.dtype) == (np.float64, np.float32)


def test_arrays_of_older_numpy_versions_are_known_by_their_old_names(tmp_path):
    data = pickle.dumps([OUTER, INNER], 2).replace(b"numpy._core.multiarray", b"numpy.core.multiarray")
    np.testing.assert_array_equal(read(tmp_path, data)[0], OUTER)


@pytest.mark.parametrize("protocol", [2, 5])
@pytest.mark.parametrize(
    "array",
    [
        np.asfortranarray(OUTER),
        OUTER.astype(">f8"),
        OUTER.astype(np.int16),
        np.float64(2.5),
    ],
    ids=["column order", "big endian", "integers", "scalar"],
)
def test_arrays_of_every_order_and_kind_keep_their_values(tmp_path, array, protocol):
    found = read(tmp_path, pickle.dumps(array, protocol))
    np.testing.assert_array_equal(found, array)
    assert found.shape == np.shape(array)


def test_a_split_is_two_lists_of_names(tmp_path):
    assert read(tmp_path, pickle.dumps((["0", "4"], ["1"]), 2)) == (["0", "4"], ["1"])


class Runs:
    """Runs a command when an ordinary reader loads it."""

    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


def raw(*parts):
    return b"\x80\x02" + b"".join(parts) + b"."


HOSTILE = {
    "a command": lambda mark: pickle.dumps(Runs(os.system, f"touch {mark}")),
    "a command, old protocol": lambda mark: pickle.dumps(Runs(os.system, f"touch {mark}"), 0),
    "an expression": lambda mark: pickle.dumps(Runs(eval, f"open({str(mark)!r}, 'w')")),
    "a file": lambda mark: pickle.dumps(Runs(open, str(mark), "w")),
    "a command inside a camera": lambda mark: pickle.dumps([OUTER, Runs(os.system, f"touch {mark}")]),
    "numpy's own loader": lambda mark: pickle.dumps(Runs(np.load, str(mark))),
    "an instance": lambda mark: b"(S'touch " + str(mark).encode() + b"'\nios\nsystem\n.",
    "a class": lambda mark: raw(b"(cos\nsystem\nX\x01\0\0\0ao"),
    "a new object": lambda mark: raw(b"cnumpy\nndarray\n)\x81"),
    "a registered extension": lambda mark: raw(b"\x82\x01"),
    "a persistent name": lambda mark: b"Pname\n.",
    "a module of numpy": lambda mark: raw(b"cnumpy.testing\nrundocs\n)R"),
    "state for a function": lambda mark: raw(b"cnumpy\nndarray\n(X\x01\0\0\0aK\x01tb"),
    "an array of objects": lambda mark: pickle.dumps(
        np.array([Runs(os.system, f"touch {mark}")], dtype=object)
    ),
    "an array of records": lambda mark: pickle.dumps(np.zeros(2, dtype=[("a", "f8")])),
    "a dictionary": lambda mark: pickle.dumps({"a": 1}),
    "a list within itself": lambda mark: raw(b"]q\x00h\x00a"),
    "a huge shape": lambda mark: pickle.dumps(np.zeros(2), 2).replace(b"K\x02\x85", b"J\xff\xff\xff\x7f\x85"),
    "a huge table": lambda mark: raw(b"K\x01r\xff\xff\xff\x7fK\x02j\xfe\xff\xff\x7f"),
    "a huge text": lambda mark: b"\x80\x04\x8d" + struct.pack("<Q", 2**40) + b"a.",
    "an endless list": lambda mark: raw(b"]" + b"K\x01a" * 150_000),
    "an announced array of bytes": lambda mark: b"\x80\x05\x96" + struct.pack("<Q", 2**40) + b"a.",
    "one text copied often": lambda mark: raw(
        b"]c_codecs\nencode\nq\1X\0\0\x08\0" + b"a" * 2**19 + b"X\6\0\0\0latin1\x86q\2R" + b"h\1h\2R" * 50_000
    ),
    "lists of one list, often": lambda mark: raw(
        b"]q\0" + b"".join(b"](" + b"h%c" % i * 100 + b"eq%c" % (i + 1) for i in range(6))
    ),
    "too many bytes": lambda mark: pickle.dumps(b"a" * (MAX_BYTES + 1)),
    "nothing": lambda mark: b"",
    "no pickle": lambda mark: b"# camera\n1 0 0\n",
    "only a function": lambda mark: raw(b"cnumpy\nndarray\n"),
    "an array without contents": lambda mark: pickle.dumps(OUTER, 2)[:80] + b".",
}


@pytest.mark.parametrize("make", HOSTILE.values(), ids=HOSTILE.keys())
def test_anything_but_plain_data_is_refused_and_not_run(tmp_path, make):
    mark = tmp_path / "was_here"
    with pytest.raises(PickleRefusedError):
        read(tmp_path, make(mark))
    assert not mark.exists()


@settings(max_examples=40, deadline=None)
@given(changes=st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), min_size=1, max_size=6))
def test_a_damaged_camera_reads_as_data_or_is_refused(tmp_path_factory, changes):
    data = bytearray(pickle.dumps([OUTER, INNER], 2))
    for place, value in changes:
        data[place % len(data)] = value
    try:
        value = read(tmp_path_factory.mktemp("a"), bytes(data))
    except PickleRefusedError:
        return
    assert isinstance(value, list | tuple | np.ndarray | int | float | str | bytes | None)


@pytest.mark.parametrize("length", range(0, len(pickle.dumps(INNER, 2)), 7))
def test_a_camera_that_ends_early_is_refused(tmp_path, length):
    with pytest.raises(PickleRefusedError):
        read(tmp_path, pickle.dumps(INNER, 2)[:length])
