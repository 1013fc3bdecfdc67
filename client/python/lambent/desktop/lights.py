"""The environments that can be chosen in a viewer: files, and what was recovered with the object."""

from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock

from lambent_relight import Bundle, Environment
from lambent_relight.environment.input import EnvironmentInput, open_environment

_KEPT = 4
"""Maps that stay in memory; the renderer knows a map again by its array."""


@dataclass(eq=False)
class Lights:
    """A list of environments, each read when it is first needed."""

    bundle: Bundle
    given: EnvironmentInput = field(default_factory=EnvironmentInput)
    """How files are to be understood."""
    _sources: list[Path | str] = field(default_factory=list)
    """A file, or the name of a training light."""
    _open: dict[int, Environment] = field(default_factory=dict)
    _notes: dict[int, list[str]] = field(default_factory=dict)
    _reading: Lock = field(default_factory=Lock)
    """The window's thread and the painter's both read."""

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._sources)

    def name(self, number: int) -> str:
        """Return what to call an environment."""
        source = self._sources[number]
        return source.name if isinstance(source, Path) else f"{source} (recovered)"

    def add_file(self, path: Path) -> int:
        """Add a file at the end and return its number; one that is listed already keeps its number."""
        if path not in self._sources:
            self._sources.append(path)
        return self._sources.index(path)

    def add_recovered(self) -> None:
        """Add the environments that were recovered from the photographs."""
        self._sources += list(self.bundle.manifest.train_lights)

    def recovered(self, light: str) -> int | None:
        """Return the number of the environment of a training light."""
        return self._sources.index(light) if light in self._sources else None

    def remove(self, number: int) -> None:
        """Forget the environment `number`, which must be the last."""
        assert number == len(self._sources) - 1, "other numbers would change"
        with self._reading:
            self._sources.pop()
            self._open.pop(number, None)

    def environment(self, number: int) -> Environment:
        """Return an environment, not turned; raises RelightError for a file that cannot be used."""
        with self._reading:
            known = self._open.get(number)
            if known is not None:
                return known
            source = self._sources[number]
            if isinstance(source, Path):
                opened = open_environment(source, self.given)
                read, self._notes[number] = opened.environment, opened.notes(source.name)
            else:
                read = self.bundle.trained_environment(source)
            while len(self._open) >= _KEPT:
                self._open.pop(next(iter(self._open)))
            self._open[number] = read
            return read

    def notes(self, number: int) -> list[str]:
        """Return what was done to a file when it was read, in sentences."""
        return self._notes.get(number, [])
