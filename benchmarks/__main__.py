"""The entry point of all benchmarks.

    python -m benchmarks                       lists the names, with a sentence each
    python -m benchmarks NAME --help           lists the options
    python -m benchmarks NAME [options]        runs a benchmark
    python -m benchmarks NAME --quick          runs it on a small scale: to test it, not for its figures
    python -m benchmarks --quick-all           runs all quick variants, each in its own process
    python -m benchmarks --claims [FILE]       measures what is said to be faster (ten minutes)
    python -m benchmarks --compare OLD NEW     compares two such files; fails where a ratio fell by 15 %

The output, and a description of the machine, are stored in OUT/result.json.
"""

import argparse
import ast
import importlib
import io
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from contextlib import redirect_stdout
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lambent_compute.threads import available_threads

from benchmarks import claims

ROOT = Path(__file__).parent.parent
BUILD = ROOT / "build" / "benchmarks"
SAMPLE = ROOT / "tests" / "data" / "still_life"


def benchmarks() -> dict[str, str]:
    """Return the first docstring line of every benchmark (module with a quick variant) by name."""
    programs = {}
    for path in sorted(Path(__file__).parent.glob("*.py")):
        text = path.read_text(encoding="utf-8")
        if "\nQUICK = " in text:
            programs[path.stem] = (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
    return programs


def machine() -> dict[str, Any]:
    """Return a description of the machine: processor, cores and threads, system, versions."""
    names = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").is_file() else []
    model = next((line.partition(": ")[2] for line in names if line.startswith("model name")), "")
    packages = ("torch", "numpy", "numba", "onnxruntime")
    return {
        "processor": model or platform.processor(),
        "cores": available_threads(),
        "threads": os.environ.get("OMP_NUM_THREADS", "as many as cores"),
        "system": platform.platform(),
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


def quick_options(text: str) -> list[str]:
    """Return the options of a quick variant; the run some need is that of the quick `quality`."""
    made = BUILD / "quality" / f"{SAMPLE.name}_0"
    run, maps = made / "run", SAMPLE / "envmaps"
    if ("{run}" in text or "{bundle}" in text) and not (made / "report" / "pred").is_dir():
        subprocess.run([sys.executable, "-m", "benchmarks", "quality", "--quick"], cwd=ROOT, check=True)
    return text.format(sample=SAMPLE, maps=maps, run=run, bundle=run / "bundle").split()


class Tee(io.StringIO):
    """Records the output and passes it on."""

    def write(self, text: str) -> int:
        """Record and print `text`; return the number of characters."""
        sys.__stdout__.write(text)
        return super().write(text)

    def flush(self) -> None:
        """Flush the output."""
        sys.__stdout__.flush()


def run(name: str, words: list[str]) -> None:
    """Run a benchmark and store what it printed and returned."""
    module = importlib.import_module(f"benchmarks.{name}")
    parser = argparse.ArgumentParser(
        f"python -m benchmarks {name}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_options(parser)
    parser.add_argument("--quick", action="store_true", help=f"as with: {module.QUICK}")
    if hasattr(module, "CLAIMS"):
        parser.add_argument("--claims", action="store_true", help=f"as with: {module.CLAIMS}")
    parser.add_argument("-o", "--out", type=Path, default=BUILD / name, help="folder (default: %(default)s)")
    if "--quick" in words:
        words = quick_options(module.QUICK) + words
    if "--claims" in words:
        words = quick_options(module.CLAIMS) + words
    options = parser.parse_args(words)
    options.out.mkdir(parents=True, exist_ok=True)
    about = machine()
    print(", ".join(f"{key} {value}" for key, value in about.items()), "\n", flush=True)
    began = time.perf_counter()
    with redirect_stdout(Tee()) as printed:
        result = module.main(options)
    record = {
        "benchmark": name,
        "machine": about,
        "options": vars(options),
        "seconds": time.perf_counter() - began,
        "printed": printed.getvalue(),
        "result": result,
    }
    (options.out / "result.json").write_text(json.dumps(record, indent=1, default=str) + "\n")


def run_all_quick() -> int:
    """Run all quick variants and print the time of each; return 1 if one fails."""
    rows = {}
    for name in benchmarks():
        print(f"\n# {name}\n", flush=True)
        began = time.perf_counter()
        code = subprocess.run([sys.executable, "-m", "benchmarks", name, "--quick"], cwd=ROOT).returncode
        rows[name] = (time.perf_counter() - began, code)
    print("\n| benchmark | s | |\n| --- | --- | --- |")
    for name, (seconds, code) in rows.items():
        print(f"| {name} | {seconds:.0f} | {f'failed with {code}' if code else ''} |")
    return int(any(code for _, code in rows.values()))


def run_claims(out: Path) -> int:
    """Run all benchmarks with `CLAIMS`, each in its own process, and write what they return to `out`.

    Returns 1 if one fails.
    """
    record: dict[str, Any] = {"machine": machine(), "revision": revision(), "claims": [], "ceilings": {}}
    failed = 0
    for name in benchmarks():
        module_text = (Path(__file__).parent / f"{name}.py").read_text(encoding="utf-8")
        if "\nCLAIMS = " not in module_text:
            continue
        print(f"\n# {name}\n", flush=True)
        folder = BUILD / "claims" / name
        command = [sys.executable, "-m", "benchmarks", name, "--claims", "-o", str(folder)]
        shutil.rmtree(folder, ignore_errors=True)
        if subprocess.run(command, cwd=ROOT).returncode:
            print(f"{name} failed", file=sys.stderr)
            failed = 1
            continue
        result = json.loads((folder / "result.json").read_text(encoding="utf-8"))["result"]
        if isinstance(result, dict):
            record["ceilings"] = result
        else:
            record["claims"] += result
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print("\n" + claims.table(record["claims"]) + f"\n\n{out}")
    return failed


def compare(old: Path, new: Path) -> int:
    """Print what became worse between two files of claims; return 1 if anything did."""
    before, now = (json.loads(path.read_text(encoding="utf-8")) for path in (old, new))
    print(claims.table(now["claims"]) + "\n")
    sentences = claims.worse(before["claims"], now["claims"])
    for sentence in sentences:
        print(f"worse: {sentence}")
    if not sentences:
        print(f"no ratio fell by more than {100 * (claims.WORST - 1):.0f} %")
    return int(bool(sentences))


def revision() -> str:
    """Return the revision of the working tree, empty outside of one."""
    command = ["git", "describe", "--always", "--dirty"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else ""


def main() -> int:
    """Return the exit status."""
    # A waiting thread sleeps: spinning ones would slow whatever is measured beside them.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    # Scenes of the tests, and the scene makers of the examples, are used here as well.
    sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "examples")]
    known, words = benchmarks(), sys.argv[1:]
    if words == ["--quick-all"]:
        return run_all_quick()
    if words[:1] == ["--claims"] and len(words) <= 2:
        return run_claims(Path(words[1]) if words[1:] else BUILD / "claims.json")
    if words[:1] == ["--compare"] and len(words) == 3:
        return compare(Path(words[1]), Path(words[2]))
    if words and words[0] in known:
        run(words[0], words[1:])
        return 0
    print(__doc__)
    for name, sentence in known.items():
        print(f"{name:20} {sentence}")
    if words and words[0] not in ("-h", "--help"):
        print(f"\nthere is no benchmark {words[0]!r}", file=sys.stderr)
    return int(bool(words) and words[0] not in ("-h", "--help"))


if __name__ == "__main__":
    sys.exit(main())
