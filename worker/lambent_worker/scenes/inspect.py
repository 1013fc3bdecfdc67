"""Looks at everything in a capture: cameras, every picture, and files that have no place there."""

from collections.abc import Callable
from hashlib import file_digest
from pathlib import Path

from lambent_proto.v1 import scene_pb2

from lambent_worker.scenes.detect import collect_scene
from lambent_worker.scenes.pictures import PictureError, PictureFacts, picture_facts
from lambent_worker.scenes.problems import Problems

UNSUPPORTED_SUFFIXES = {
    **dict.fromkeys((".pkl", ".pickle", ".pt", ".pth", ".ckpt", ".npz", ".joblib"), "a pickle or checkpoint"),
    **dict.fromkeys((".onnx", ".engine", ".tflite"), "a compiled model"),
    **dict.fromkeys((".exe", ".dll", ".so", ".dylib", ".sh", ".bat", ".py", ".jar"), "a program"),
}
UNSUPPORTED_STARTS = {
    b"\x7fELF": "a program",
    b"MZ": "a program",
    b"\xcf\xfa\xed\xfe": "a program",
    b"\xca\xfe\xba\xbe": "a program",
    b"#!": "a program",
    **{bytes([0x80, protocol]): "a pickle or checkpoint" for protocol in range(2, 6)},
}


def inspect_scene(
    folder: Path,
    layout: str | None = None,
    skip: frozenset[str] = frozenset(),
    announce: Callable[[str], None] = lambda path: None,
) -> scene_pb2.SceneReport:
    """Return the report on the capture in `folder`, with every problem (at most 100 findings).

    `skip` names files that must not be opened because they have brought a reader down; each is reported as an
    error. `announce` is called with the path of each file before it is decoded.
    """
    problems = Problems()
    manifest = collect_scene(folder, layout, problems)
    if folder.is_dir():
        _find_unsupported(folder, problems)
    if manifest is None:
        return scene_pb2.SceneReport(usable=False, layout=layout or "", findings=problems.findings())
    _look_at_pictures(folder, manifest, skip, announce, problems)
    trained = sum(frame.split == scene_pb2.SPLIT_TRAIN for frame in manifest.frames)
    return scene_pb2.SceneReport(
        usable=problems.usable,
        layout=manifest.layout,
        findings=problems.findings(),
        num_train_frames=trained,
        num_test_frames=len(manifest.frames) - trained,
    )


def _find_unsupported(folder: Path, problems: Problems) -> None:
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        kind = UNSUPPORTED_SUFFIXES.get(path.suffix.lower())
        if kind is None:
            with path.open("rb") as file:
                start = file.read(4)
            kind = next((k for magic, k in UNSUPPORTED_STARTS.items() if start.startswith(magic)), None)
        if kind is not None:
            name = path.relative_to(folder).as_posix()
            problems.warning(
                "scene.unsupported_file", f"{name} is {kind}; it is never loaded, so remove it", name
            )


def _look_at_pictures(
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    skip: frozenset[str],
    announce: Callable[[str], None],
    problems: Problems,
) -> None:
    seen: dict[str, str] = {}
    photographs: list[PictureFacts] = []
    for frame in manifest.frames:
        for path in [*(image.path for image in frame.images), *frame.truth.values()]:
            announce(path)
            facts = _look_at(folder, path, frame.name, skip, problems)
            if facts is None or path in frame.truth.values():
                continue
            photographs.append(facts)
            with (folder / path).open("rb") as file:
                digest = file_digest(file, "sha256").hexdigest()
            if digest in seen:
                problems.warning(
                    "scene.image_duplicate",
                    f'{path} (frame "{frame.name}") is the same file as {seen[digest]}; if the cameras '
                    "differ, one of the two poses is wrong",
                    path,
                )
            seen.setdefault(digest, path)
    if photographs and not any(facts.has_background for facts in photographs):
        problems.warning(
            "scene.no_mask",
            "no photograph has a transparent background, so everything in view is taken for the object; cut "
            "the object out and save PNG with alpha for a better result",
        )


def _look_at(
    folder: Path, path: str, frame: str, skip: frozenset[str], problems: Problems
) -> PictureFacts | None:
    if path in skip:
        problems.error(
            "scene.image_too_large",
            f'{path} (frame "{frame}") needs more memory or time than a picture may; export it smaller',
            path,
        )
        return None
    try:
        facts = picture_facts(folder / path)
    except PictureError as error:
        problems.error(error.code, f'{path} (frame "{frame}") {error}', path)
        return None
    if not facts.is_finite:
        problems.error(
            "scene.image_not_finite",
            f'{path} (frame "{frame}") holds NaN or infinity; export it again without',
            path,
        )
        return None
    if facts.is_empty:
        problems.warning(
            "scene.image_empty", f'{path} (frame "{frame}") is fully transparent; leave the frame out', path
        )
    return facts
