"""A bundle is what its server has signed, or `lambent verify` says what is not; without a server."""

import base64
import contextlib
import json
import os
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from lambent import provenance
from lambent.cli.app import run
from lambent.errors import LambentError, UsageProblemError
from lambent_server.core.settings import ServeError, Settings
from lambent_server.database.engine import Database
from lambent_server.database.model import JobRow
from lambent_server.provenance import Signer, new_key, open_signer, pre_authentication, statement_of
from support.api import sha256
from support.databases import postgresql

GIVEN: dict[str, Any] = {
    "id": "job_1",
    "run": 2,
    "kind": "train",
    "preset": "tiny",
    "params": {"a": "b"},
    "seed": 3,
    "gpus": 0,
    "scene_id": "scene_1",
    "labels": {},
    "adjustments": {},
    "handle": None,
    "started_at": 1e9,
    "created_at": 1e9,
}
JOB = JobRow(**{**dict.fromkeys(each.name for each in fields(JobRow)), **GIVEN})
FILES = {"mesh/asset.glb": b"triangles", "models/weights.bin": b"weights" * 1000}
GENERATOR = {"name": "lambent", "version": "1.2.3", "git_revision": "abcdef"}


@pytest.fixture
def signer(tmp_path: Path) -> Signer:
    return Signer(new_key())


@pytest.fixture
def bundle(tmp_path: Path, signer: Signer) -> Path:
    """Return a bundle with its signed statement beside it, and the key in key.pem."""
    folder = tmp_path / "cow.relight"
    manifest = json.dumps({"files": sorted(FILES)}).encode()
    for name, data in {**FILES, "manifest.json": manifest}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    hashes = {name: sha256(data) for name, data in {**FILES, "manifest.json": manifest}.items()}
    given = {"files": hashes, "inputs": [("IMG_1.jpg", sha256(b"a photograph"))], "generator": GENERATOR}
    statement = statement_of(JOB, bundle_id="bundle_1", key_id=signer.key_id, **given)
    provenance.beside(folder).write_text(signer.envelope(statement))
    (tmp_path / "key.pem").write_text(signer.public_pem)
    return folder


def key_of(bundle: Path) -> Path:
    return bundle.parent / "key.pem"


def statement_beside(bundle: Path) -> dict[str, Any]:
    envelope = json.loads(provenance.beside(bundle).read_text())
    return json.loads(base64.b64decode(envelope["payload"]))


def test_a_bundle_that_is_whole_says_where_it_is_from(bundle: Path, signer: Signer):
    found = provenance.verify(bundle, key=key_of(bundle))
    assert (found.num_files, found.key_id, found.trusted) == (3, signer.key_id, True)
    assert (found.made_by, found.invocation) == ("lambent 1.2.3 abcdef", "job_1/2")
    assert found.inputs == {"IMG_1.jpg": sha256(b"a photograph")}
    assert found.parameters["params"] == {"a": "b"}
    assert found.started_on == "2001-09-09T01:46:40.000Z"
    assert not provenance.verify(bundle).trusted


def test_the_answer_of_the_server_is_a_key_file_too(bundle: Path, signer: Signer):
    answer = bundle.parent / "key.json"
    answer.write_text(json.dumps({"keyid": signer.key_id, "public_key_pem": signer.public_pem}))
    assert provenance.verify(bundle, key=answer).trusted


def test_an_archive_is_verified_as_it_is(bundle: Path):
    archive = zipped(bundle, zipfile.ZIP_STORED)
    assert provenance.verify(archive, key=key_of(bundle)).num_files == 3
    data = bytearray(archive.read_bytes())
    at = data.index(b"triangles")
    data[at : at + 9] = b"trianglez"
    archive.write_bytes(data)
    with pytest.raises(LambentError, match=r"verify\.tampered"):
        provenance.verify(archive, key=key_of(bundle))


def zipped(bundle: Path, kind: int) -> Path:
    """Return the bundle as an archive with its statement beside it."""
    archive = bundle.with_name("cow.relight.zip")
    with zipfile.ZipFile(archive, "w", kind) as file:
        for name in (*FILES, "manifest.json"):
            file.write(bundle / name, name)
    shutil.copy(provenance.beside(bundle), provenance.beside(archive))
    return archive


def spoil_deflated(archive: Path) -> None:
    """Make zlib fail, whose error is not a BadZipFile."""
    with zipfile.ZipFile(archive) as file:
        entry = file.getinfo("models/weights.bin")
    data = bytearray(archive.read_bytes())
    at = entry.header_offset + 30 + len(entry.filename)
    data[at : at + 4] = b"\xff" * 4
    archive.write_bytes(data)


def say_encrypted(archive: Path) -> None:
    data = bytearray(archive.read_bytes())
    for at in range(len(data) - 4):
        if data[at : at + 4] == b"PK\x01\x02":
            data[at + 8] |= 1
    archive.write_bytes(data)


def add_link(archive: Path) -> None:
    entry = zipfile.ZipInfo("mesh/link.glb")
    entry.external_attr = 0o120777 << 16
    with zipfile.ZipFile(archive, "a") as file:
        file.writestr(entry, "/etc/passwd")


SPOILS = {
    "deflated": spoil_deflated,
    "encrypted": say_encrypted,
    "link": add_link,
    "cut off": lambda archive: archive.write_bytes(archive.read_bytes()[:200]),
}


@pytest.mark.parametrize("how", SPOILS)
def test_a_spoiled_archive_is_refused_in_a_line(bundle: Path, how: str, capsys: pytest.CaptureFixture[str]):
    archive = zipped(bundle, zipfile.ZIP_DEFLATED)
    assert run(["verify", str(archive)]) == 0
    SPOILS[how](archive)
    assert run(["verify", str(archive)]) == 1
    assert "verify.tampered" in capsys.readouterr().err


def test_a_link_in_a_folder_is_no_file_of_a_bundle(bundle: Path):
    original = bundle.parent / "elsewhere.glb"
    (bundle / "mesh/asset.glb").rename(original)
    (bundle / "mesh/asset.glb").symlink_to(original)
    with pytest.raises(LambentError, match=r"verify\.tampered"):
        provenance.verify(bundle)


def test_the_folder_in_which_one_is_has_a_statement_beside_it_too(
    bundle: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(bundle)
    assert provenance.verify(Path("."), key=key_of(bundle)).trusted
    monkeypatch.chdir(bundle / "mesh")
    assert provenance.verify(Path(".."), key=key_of(bundle)).trusted


def test_a_statement_that_never_ends_is_not_read_to_its_end(bundle: Path, monkeypatch: pytest.MonkeyPatch):
    size = provenance.beside(bundle).stat().st_size
    monkeypatch.setattr(provenance, "_MAX_STATEMENT_BYTES", size)
    assert provenance.verify(bundle).num_files == 3
    # What follows is blank, and would be cut off unnoticed.
    with provenance.beside(bundle).open("a") as file:
        file.write(" ")
    with pytest.raises(LambentError, match=r"verify\.tampered.*above"):
        provenance.verify(bundle)


MALFORMED: dict[str, Callable[[dict[str, Any]], object]] = {
    "no predicate": lambda s: s.pop("predicate"),
    "a text as predicate": lambda s: s.update(predicate="x"),
    "no dependencies": lambda s: s["predicate"]["buildDefinition"].update(resolvedDependencies=[]),
    "a number as code": lambda s: s["predicate"]["buildDefinition"].update(resolvedDependencies=[1]),
    "no subject": lambda s: s.pop("subject"),
    "a subject without a name": lambda s: s["subject"].append({}),
    "a list as name": lambda s: s["subject"][0].update(name=[]),
    "parameters that are a number": lambda s: s["predicate"]["buildDefinition"].update(externalParameters=1),
}


@pytest.mark.parametrize("how", MALFORMED)
def test_a_signed_statement_of_another_form_is_refused(bundle: Path, signer: Signer, how: str):
    statement = statement_beside(bundle)
    MALFORMED[how](statement)
    provenance.beside(bundle).write_text(signer.envelope(statement))
    with pytest.raises(LambentError, match=r"verify\.tampered"):
        provenance.verify(bundle, key=key_of(bundle))


def edit_envelope(bundle: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = provenance.beside(bundle)
    envelope = json.loads(path.read_text())
    change(envelope)
    path.write_text(json.dumps(envelope))


def change_statement(bundle: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change what the statement says, without a new signature."""
    statement = statement_beside(bundle)
    change(statement)
    payload = base64.b64encode(json.dumps(statement).encode()).decode()
    edit_envelope(bundle, lambda envelope: envelope.update(payload=payload))


def sign_anew(bundle: Path) -> None:
    """Do what an attacker does who has a key, but not the server's."""
    (bundle / "mesh/asset.glb").write_bytes(b"another object")
    statement = statement_beside(bundle)
    for each in statement["subject"]:
        if each["name"] == "mesh/asset.glb":
            each["digest"]["sha256"] = sha256(b"another object")
    provenance.beside(bundle).write_text(Signer(new_key()).envelope(statement))


def claim_other(envelope: dict[str, Any]) -> None:
    envelope["signatures"][0]["keyid"] = "0" * 64


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


TAMPERINGS: dict[str, Callable[[Path], object]] = {
    "a bit of a file": lambda b: flip(b / "models/weights.bin"),
    "a bit of the manifest": lambda b: flip(b / "manifest.json"),
    "a file that is gone": lambda b: (b / "mesh/asset.glb").unlink(),
    "a file that was added": lambda b: (b / "mesh/extra.glb").write_bytes(b""),
    "a bit of the statement": lambda b: flip(provenance.beside(b)),
    "another version of the code": lambda b: change_statement(
        b, lambda s: s["predicate"]["buildDefinition"]["resolvedDependencies"][0].update(name="x")
    ),
    "another input": lambda b: change_statement(
        b, lambda s: s["predicate"]["buildDefinition"]["resolvedDependencies"].pop()
    ),
    "another time": lambda b: change_statement(
        b, lambda s: s["predicate"]["runDetails"]["metadata"].update(startedOn="2020-01-01T00:00:00Z")
    ),
    "no signature": lambda b: edit_envelope(b, lambda e: e.update(signatures=[])),
    "another type": lambda b: edit_envelope(b, lambda e: e.update(payloadType="text/plain")),
    "another name of the key": lambda b: edit_envelope(b, claim_other),
    "no envelope": lambda b: provenance.beside(b).write_text("[]"),
}


@pytest.mark.parametrize("with_key", [True, False], ids=["with the key", "without the key"])
@pytest.mark.parametrize("how", TAMPERINGS)
def test_tampering_is_noticed(bundle: Path, how: str, with_key: bool):
    TAMPERINGS[how](bundle)
    with pytest.raises(LambentError) as refused:
        provenance.verify(bundle, key=key_of(bundle) if with_key else None)
    assert (refused.value.code, refused.value.exit_code) == ("verify.tampered", 1)


def test_only_the_key_says_who_has_signed(bundle: Path, signer: Signer):
    sign_anew(bundle)
    found = provenance.verify(bundle)
    assert not found.trusted
    assert found.key_id != signer.key_id
    with pytest.raises(LambentError, match="not signed by the key"):
        provenance.verify(bundle, key=key_of(bundle))


def test_what_is_not_there_is_named(bundle: Path, tmp_path: Path):
    with pytest.raises(UsageProblemError, match=r"verify\.no_bundle"):
        provenance.verify(tmp_path / "none.relight")
    (tmp_path / "bad.pem").write_text("not a key")
    with pytest.raises(UsageProblemError, match=r"verify\.no_key"):
        provenance.verify(bundle, key=tmp_path / "bad.pem")
    provenance.beside(bundle).unlink()
    with pytest.raises(UsageProblemError, match=r"verify\.no_statement"):
        provenance.verify(bundle)


def test_the_command_says_it_in_a_line_or_as_json(bundle: Path, capsys: pytest.CaptureFixture[str]):
    assert run(["verify", str(bundle), "--key", str(key_of(bundle))]) == 0
    assert "3 files are as stated, signed by " in capsys.readouterr().out
    assert run(["verify", str(bundle), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["trusted"] is False
    flip(bundle / "models/weights.bin")
    assert run(["verify", str(bundle)]) == 1
    assert "models/weights.bin was changed" in capsys.readouterr().err


def test_the_key_of_a_server_stays_and_only_its_owner_reads_it(tmp_path: Path):
    settings = Settings(data=tmp_path)
    with contextlib.closing(Database(settings.database_url)) as database:
        first = open_signer(database, settings)
        assert open_signer(database, settings).key_id == first.key_id
        path = tmp_path / "provenance.key"
        assert oct(path.stat().st_mode & 0o777) == "0o600"
        assert os.listdir(tmp_path) == ["provenance.key"]
        other = open_signer(database, Settings(data=tmp_path, provenance_key=tmp_path / "other.key"))
        assert other.key_id != first.key_id
        path.write_text("not a key")
        with pytest.raises(ServeError, match=r"provenance\.key contains no private key"):
            open_signer(database, settings)


@pytest.mark.services
def test_servers_on_one_database_have_one_key(tmp_path: Path):
    with postgresql() as url:
        settings = [Settings(data=tmp_path / name, database=url) for name in ("a", "b")]
        with contextlib.closing(Database(settings[0].database_url)) as database:
            database.migrate()
            first, second = (open_signer(database, each) for each in settings)
    assert first.key_id == second.key_id


def test_what_is_signed_is_that_of_dsse():
    # The example of the specification.
    payload = b"hello world"
    signed = pre_authentication("http://example.com/HelloWorld", payload)
    assert signed == b"DSSEv1 29 http://example.com/HelloWorld 11 hello world"
