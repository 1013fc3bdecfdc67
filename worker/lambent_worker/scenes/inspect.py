"""Checks everything in a capture: cameras, every picture, and files that do not belong there."""

from collections.abc import Callable
from pathlib import Path

from lambent_proto.v1 import scene_pb2

from lambent_worker.files import file_sha256
from lambent_worker.scenes import glossy_synthetic, photographs
from lambent_worker.scenes.detect import collect_scene, detect_layout
from lambent_worker.scenes.picture_error import PictureError
from lambent_worker.scenes.pictures import PictureFacts, picture_facts, picture_size, read_coverage
from lambent_worker.scenes.problems import Problems
from lambent_worker.scenes.silhouette_check import check_silhouettes, training_silhouettes

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


def inspect_capture(
    folder: Path,
    layout: str | None = None,
    skip: frozenset[str] = frozenset(),
    announce: Callable[[str], None] = lambda path: None,
    masks: Path | None = None,
    cameras: Path | None = None,
) -> tuple[scene_pb2.SceneReport, scene_pb2.SceneManifest | None]:
    """Return the report on the capture in `folder` (at most 100 findings), and the manifest it is about.

    `skip` names files that must not be opened because they have brought a reader down; each is reported as an
    error. `announce` is called with the path of each file before it is decoded. `masks` is a folder of masks
    that override those of the layout, `cameras` one of cameras that were found for photographs.
    """
    problems = Problems()
    manifest = collect_scene(folder, layout, problems, masks, cameras)
    if folder.is_dir():
        is_glossy = (layout or detect_layout(folder)) == glossy_synthetic.NAME
        known = glossy_synthetic.pickles_of(folder) if is_glossy else set()
        _find_unsupported(folder, known, problems)
    if manifest is None:
        report = scene_pb2.SceneReport(usable=False, layout=layout or "", findings=problems.findings())
        return report, None
    _look_at_pictures(folder, manifest, skip, announce, problems)
    trained = sum(frame.split == scene_pb2.SPLIT_TRAIN for frame in manifest.frames)
    report = scene_pb2.SceneReport(
        usable=problems.usable,
        layout=manifest.layout,
        findings=problems.findings(),
        num_train_frames=trained,
        num_test_frames=len(manifest.frames) - trained,
    )
    return report, manifest


def _find_unsupported(folder: Path, known: set[Path], problems: Problems) -> None:
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and p not in known):
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
    masked = [False]
    for frame in manifest.frames:
        for image in frame.images:
            announce(image.path)
            facts = _look_at(folder, image.path, frame.name, skip, problems)
            if facts is None:
                continue
            masked.append(facts.has_background)
            _note_duplicate(folder, image.path, frame.name, seen, problems)
        for path in frame.truth.values():
            announce(path)
            _look_at(folder, path, frame.name, skip, problems)
        if frame.mask:
            announce(frame.mask)
            masked.append(True)
            _look_at_mask(folder, frame, skip, problems)
    without_cameras = photographs.lacks_cameras(manifest.frames)
    if not any(masked) and not without_cameras:
        problems.warning(
            "scene.no_mask",
            "no photograph has a transparent background and there are no masks, so training will have to "
            "guess where the object is (lambent masks shows how well); cut the object out and save PNG with "
            "alpha, or add masks, for a better result",
        )
    if problems.usable and not without_cameras:
        announce("")
        check_silhouettes(training_silhouettes(folder, manifest, problems), problems)


def _note_duplicate(folder: Path, path: str, frame: str, seen: dict[str, str], problems: Problems) -> None:
    digest = file_sha256(folder / path)
    if digest in seen:
        problems.warning(
            "scene.image_duplicate",
            f'{path} (frame "{frame}") is the same file as {seen[digest]}; if the cameras differ, one of the '
            "two poses is wrong",
            path,
        )
    seen.setdefault(digest, path)


def _look_at_mask(folder: Path, frame: scene_pb2.Frame, skip: frozenset[str], problems: Problems) -> None:
    if frame.mask in skip:
        _note_too_large(frame.mask, frame.name, problems)
        return
    try:
        coverage = read_coverage(folder / frame.mask, frame.mask_encoding)
        width, height = picture_size(folder / frame.images[0].path)
    except PictureError as error:
        problems.error(error.code, f'{frame.mask} (frame "{frame.name}") {error}', frame.mask)
        return
    if coverage.shape != (height, width):
        problems.error(
            "scene.mask_size",
            f'{frame.mask} (frame "{frame.name}") has {coverage.shape[1]} x {coverage.shape[0]} pixels, its '
            f"photograph has {width} x {height}; make them one size",
            frame.mask,
        )
    elif not (coverage > 0.0).any():
        problems.error(
            "scene.mask_empty",
            f'{frame.mask} (frame "{frame.name}") says that the object is not in the picture; fix the mask '
            "or leave the frame out",
            frame.mask,
        )


def _look_at(
    folder: Path, path: str, frame: str, skip: frozenset[str], problems: Problems
) -> PictureFacts | None:
    if path in skip:
        _note_too_large(path, frame, problems)
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


def _note_too_large(path: str, frame: str, problems: Problems) -> None:
    problems.error(
        "scene.image_too_large",
        f'{path} (frame "{frame}") needs more memory or time than a picture may; export it smaller',
        path,
    )
