"""Deliberate mistakes, and the tests that catch them: `python tests/mutants.py --help`.

A mutant is an entry of `mutants.toml`: one passage of our source, found by its symbol and its tokens, and a
plausible mistake that replaces it. The working tree is never changed; each mutant is made in a copy, and only
its nearest tests run.
"""

import argparse
import json
import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from support import passages

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
SOURCES = ("proto", "server", "worker", "client/python")
GROUPS = ("method", "export", "relight", "server")
_ANEW = "name it anew in tests/mutants.toml"
BEGIN, END = "<!-- mutants: begin -->", "<!-- mutants: end -->"
CAUGHT, SURVIVED, UNDECIDED = "caught", "SURVIVED", "NO VERDICT"
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+\.py::.+?)(?: - .*)?$", re.MULTILINE)
_ROW = re.compile(r"^\| (\w+) \| `([\w-]+)` \| (.+) \| (.+) \|$", re.MULTILINE)


@dataclass(frozen=True, kw_only=True, slots=True)
class Mutant:
    """One mistake."""

    name: str
    group: str
    old: str
    """The passage: code that occurs once in the symbol, however it is wrapped, or text of `file`."""
    new: str
    tests: tuple[str, ...]
    """Nearest tests: the ends of their files' paths, with `::test_name` where one test will do."""
    breaks: str
    """What the mistake breaks, in one sentence."""
    symbol: str = ""
    """The end of the full name of what the passage is in, such as `stage_two.StageTwo.step`."""
    file: str = ""
    """Instead of a symbol: path of a file from the repository's root, for text that is not Python code."""

    @property
    def place(self) -> Path:
        """Path of the source file from the repository's root; raises ValueError for an unknown symbol."""
        return Path(self.file) if self.file else self._symbol()[0].relative_to(ROOT)

    def text(self) -> str:
        """Return the file with the mistake; raises ValueError unless the passage occurs exactly once."""
        text = (ROOT / self.place).read_text(encoding="utf-8")
        if self.symbol:
            _, *lines = self._symbol()
            try:
                return passages.replaced(text, (lines[0], lines[1]), self.old, self.new)
            except ValueError as error:
                raise ValueError(f"mutant {self.name}, {self.symbol}: {error}; {_ANEW}") from error
        if text.count(self.old) != 1:
            count = text.count(self.old)
            raise ValueError(f"mutant {self.name}: its passage occurs {count} times in {self.file}; {_ANEW}")
        return text.replace(self.old, self.new)

    def _symbol(self) -> tuple[Path, int, int]:
        try:
            return passages.place_of(self.symbol, tuple(ROOT / source for source in SOURCES))
        except ValueError as error:
            raise ValueError(f"mutant {self.name}: {error}; {_ANEW}") from error

    def targets(self) -> list[str]:
        """Return its nearest tests as pytest takes them, from the root; raises ValueError if unknown."""
        found = []
        for test in self.tests:
            name, colons, function = test.partition("::")
            paths = [path for path in test_files() if path.as_posix().endswith(f"/{name}")]
            if len(paths) != 1 or (colons and f"def {function}(" not in paths[0].read_text(encoding="utf-8")):
                raise ValueError(
                    f"mutant {self.name}: {len(paths)} files under tests/ end in {name}, expected one, with "
                    f"{function or 'any test'}; name another in tests/mutants.toml"
                )
            found.append(paths[0].relative_to(ROOT).as_posix() + colons + function)
        return found


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """The outcome of a mutant."""

    name: str
    outcome: str
    by: str
    """The test that failed, or why there is no verdict."""
    seconds: float


def read_mutants(path: Path = TESTS / "mutants.toml") -> list[Mutant]:
    """Return all mutants, group by group."""
    rows = tomllib.loads(path.read_text(encoding="utf-8"))["mutant"]
    found = [Mutant(**(row | {"tests": tuple(row["tests"])})) for row in rows]
    return sorted(found, key=lambda mutant: GROUPS.index(mutant.group))


@cache
def test_files() -> list[Path]:
    """Return all files of tests."""
    return list(TESTS.rglob("test_*.py"))


class Copy:
    """A copy of our packages beside links to everything else, in which one mutant at a time is made."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        parents = {Path(source).parent for source in SOURCES}
        for parent in sorted(parents):
            (folder / parent).mkdir(parents=True, exist_ok=True)
            for entry in (ROOT / parent).iterdir():
                place = entry.relative_to(ROOT)
                if place.as_posix() in SOURCES:
                    shutil.copytree(entry, folder / place, symlinks=True)
                elif place not in parents and entry.name != ".git":
                    (folder / place).symlink_to(entry)

    def judge(self, mutant: Mutant, timeout_s: float) -> Verdict:
        """Return whether the nearest tests notice the mutant."""
        place = self.folder / mutant.place
        start = time.monotonic()
        with tempfile.TemporaryDirectory(dir=self.folder.parent) as compiled:
            # Compiled loops are cached by their file's date, and would survive a change in what they call.
            environment = (
                {"NUMBA_CACHE_DIR": compiled} if "numba" in place.read_text(encoding="utf-8") else {}
            )
            place.write_text(mutant.text(), encoding="utf-8")
            try:
                code, said = self.run(mutant.targets(), timeout_s, environment)
            finally:
                shutil.copy2(ROOT / mutant.place, place)
        failed = _FAILED.findall(said)
        if code == 1 and failed:
            outcome, by = CAUGHT, failed[0]
        elif code == 0:
            outcome, by = SURVIVED, ""
        else:
            outcome, by = UNDECIDED, " ".join(said.strip().splitlines()[-1:]) or f"pytest ended with {code}"
        return Verdict(name=mutant.name, outcome=outcome, by=by, seconds=time.monotonic() - start)

    def run(self, targets: list[str], timeout_s: float, environment: dict[str, str]) -> tuple[int, str]:
        """Return pytest's exit status and output; a run past `timeout_s` is ended and has status -1."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--tb=no", *targets]
        paths = os.pathsep.join(str(self.folder / source) for source in SOURCES)
        settings = {
            "OMP_NUM_THREADS": "1",
            "OMP_WAIT_POLICY": "PASSIVE",
            "PYTHONPATH": paths,
            "COLUMNS": "400",
            "LAMBENT_TEST_ALL": "1",
        }
        process = subprocess.Popen(
            command,
            cwd=self.folder,
            env=os.environ | settings | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            said, _ = process.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return -1, f"not finished after {timeout_s:g} s"
        return process.returncode, said


def judge_all(mutants: list[Mutant], *, jobs: int, timeout_s: float) -> list[Verdict]:
    """Return a verdict for each mutant, and print each as soon as it is known.

    A test that also fails without a mutant has caught nothing: its verdicts are withdrawn.
    """
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(jobs) as pool:
        copies: queue.Queue[Copy] = queue.Queue()
        for index in range(min(jobs, len(mutants))):
            copies.put(Copy(Path(folder) / str(index)))

        def judge(mutant: Mutant) -> Verdict:
            copy = copies.get()
            try:
                verdict = copy.judge(mutant, timeout_s)
            finally:
                copies.put(copy)
            print(f"{verdict.outcome:10} {verdict.seconds:5.0f} s  {mutant.name}  {verdict.by}", flush=True)
            return verdict

        try:
            verdicts = list(pool.map(judge, mutants))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        catching = sorted({verdict.by for verdict in verdicts if verdict.outcome == CAUGHT})
        if not catching:
            return verdicts
        code, said = copies.get().run(catching, timeout_s * len(catching), {})
    if code == 0:
        return verdicts
    print(said)
    why = "the test also fails without the mutant"
    return [
        Verdict(name=v.name, outcome=UNDECIDED, by=why, seconds=v.seconds) if v.outcome == CAUGHT else v
        for v in verdicts
    ]


def updated(page: str, mutants: list[Mutant], verdicts: list[Verdict]) -> str:
    """Return `page` with an updated table between its markers: new verdicts, and the other earlier ones."""
    before, _, rest = page.partition(BEGIN)
    table, marker, after = rest.partition(END)
    if not marker:
        raise ValueError(f"the page has no {BEGIN} and {END} to write between")
    said = {name: by for _, name, _, by in _ROW.findall(table)}
    for verdict in verdicts:
        _, _, test = verdict.by.partition("::")
        file = verdict.by.partition("::")[0].rpartition("/")[2]
        caught = f"`{file}`: {test.partition('[')[0].removeprefix('test_').replace('_', ' ')}"
        left = f"{verdict.outcome} {verdict.by}".rstrip()
        said[verdict.name] = caught if verdict.outcome == CAUGHT else left
    lines = ["| group | mutant | what it breaks | noticed by |", "| --- | --- | --- | --- |"]
    for mutant in mutants:
        breaks, by = mutant.breaks.replace("|", "\\|"), said.get(mutant.name, "not run yet")
        lines.append(f"| {mutant.group} | `{mutant.name}` | {breaks} | {by} |")
    return f"{before}{BEGIN}\n" + "\n".join(lines) + f"\n{END}{after}"


def main(arguments: list[str] | None = None) -> int:
    """Run the program and return its exit status: 1 if a mutant survives or has no verdict."""
    parser = argparse.ArgumentParser(
        description="Make mistakes on purpose and report which test catches each."
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="mutants to make; all of them by default")
    parser.add_argument("--group", choices=GROUPS, help="make the mutants of this group only")
    parser.add_argument("--list", action="store_true", help="list the mutants and make none")
    parser.add_argument("-j", dest="jobs", type=int, default=1, help="mutants at the same time")
    parser.add_argument("--timeout", type=float, default=240.0, help="seconds that a mutant's tests may take")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the verdicts there")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="renew the table in this page")
    options = parser.parse_args(arguments)
    everything = read_mutants()
    unknown = set(options.names) - {mutant.name for mutant in everything}
    if unknown:
        parser.error(f"there is no mutant {', '.join(sorted(unknown))}; --list shows them")
    chosen = [
        mutant
        for mutant in everything
        if mutant.name in (options.names or [mutant.name]) and mutant.group == (options.group or mutant.group)
    ]
    for mutant in chosen:
        mutant.text(), mutant.targets()
    if options.list:
        for mutant in chosen:
            print(f"{mutant.group:8} {mutant.name:36} {mutant.breaks}")
        return 0
    verdicts = judge_all(chosen, jobs=max(1, options.jobs), timeout_s=options.timeout)
    left = [verdict for verdict in verdicts if verdict.outcome != CAUGHT]
    print(f"{len(verdicts) - len(left)} of {len(verdicts)} mutants were noticed")
    for verdict in left:
        print(f"{verdict.outcome}: {verdict.name} {verdict.by}")
    if options.json:
        options.json.write_text(json.dumps([asdict(verdict) for verdict in verdicts], indent=1) + "\n")
    if options.write:
        page = options.write.read_text(encoding="utf-8")
        options.write.write_text(updated(page, everything, verdicts), encoding="utf-8")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
