"""Regenerate what is made from the .proto files and from the server's routes, or check that it is current.

python scripts/schema.py            rewrites the files
python scripts/schema.py --check    lists the files that differ and ends with 1
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PROTO = ROOT / "proto"
PACKAGE = Path("lambent_proto/v1")
OPENAPI = Path("docs/reference/openapi.json")
# Only this file has a service, so only it has client and server stubs.
SERVICES = {"worker.proto"}


def generate_python(target: Path) -> None:
    """Write the Python of every .proto file under `target`."""
    for source in sorted((PROTO / PACKAGE).glob("*.proto")):
        command = [sys.executable, "-m", "grpc_tools.protoc", f"--proto_path={PROTO}"]
        command += [f"--python_out={target}", f"--pyi_out={target}"]
        if source.name in SERVICES:
            command.append(f"--grpc_python_out={target}")
        subprocess.run([*command, str(source.relative_to(PROTO))], cwd=PROTO, check=True)


def generate_openapi(target: Path) -> None:
    """Write the description of the REST interface to `target`."""
    from lambent_server.app import describe

    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(describe(), indent=1, sort_keys=True) + "\n", encoding="utf-8")


def generated(folder: Path) -> Iterator[tuple[Path, Path]]:
    """Yield (fresh file under `folder`, its place in the repository)."""
    for path in sorted((folder / "proto" / PACKAGE).glob("*_pb2*")):
        yield path, PROTO / PACKAGE / path.name
    yield folder / OPENAPI, ROOT / OPENAPI


def lint() -> None:
    """Check the .proto files against the rules of buf.yaml."""
    subprocess.run([str(Path(sys.executable).parent / "buf"), "lint"], cwd=ROOT, check=True)


def main() -> int:
    """Return 0 when everything is (or now is) current."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, only compare")
    check = parser.parse_args().check
    lint()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "proto").mkdir()
        generate_python(folder / "proto")
        if not check:
            # The routes import the messages, so these must be in place first.
            for path in (folder / "proto" / PACKAGE).glob("*_pb2*"):
                (PROTO / PACKAGE / path.name).write_bytes(path.read_bytes())
        generate_openapi(folder / OPENAPI)
        stale = [
            place
            for fresh, place in generated(folder)
            if not place.exists() or place.read_bytes() != fresh.read_bytes()
        ]
        for place in stale:
            if check:
                print(f"differs: {place.relative_to(ROOT)}; run `make schema`", file=sys.stderr)
            else:
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes((folder / place.relative_to(ROOT)).read_bytes())
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
