"""Checks everything in a capture: cameras, every picture, and files that do not belong there."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from lambent_core.files import file_sha256
from lambent_core.layouts import BENCHMARKS, LAYOUTS, PHOTOGRAPHS
from lambent_proto.v1 import scene_pb2

from lambent_capture.layouts import photographs
from lambent_capture.layouts.detect import collect_scene, detect_layout
from lambent_capture.layouts.readers import reader_of
from lambent_capture.layouts.unread_formats import note_unread
from lambent_capture.pictures.coverage import frame_mask
from lambent_capture.pictures.exif import exif_facts
from lambent_capture.pictures.mask_levels import Mask
from lambent_capture.pictures.picture_error import NOTHING_SKIPPED, SKIPPED, PictureError
from lambent_capture.pictures.pictures import PictureFacts, picture_facts, picture_size
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import listed
from lambent_capture.scenes.links import leads_inside
from lambent_capture.scenes.lost_frames import are_few
from lambent_capture.scenes.silhouette_check import check_silhouettes, training_silhouettes

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


@dataclass(frozen=True, kw_only=True, slots=True)
class Inspection:
    """Everything that looking at the files of a capture has shown."""

    report: scene_pb2.SceneReport
    """At most 100 findings."""
    manifest: scene_pb2.SceneManifest | None = None
    left_out: tuple[str, ...] = ()
    """Pictures that cannot be decoded, whose frames are not in `manifest`."""


def inspect_files(
    folder: Path,
    layout: str | None = None,
    skip: Mapping[str, str] = NOTHING_SKIPPED,
    announce: Callable[[str], None] = lambda path: None,
    masks: Path | None = None,
    cameras: Path | None = None,
) -> Inspection:
    """Return what is to be said of the capture in `folder` after decoding all of its pictures.

    `skip` has files that must not be opened because they have brought a reader down, with the code of how
    (`SKIPPED`); each counts as a picture that cannot be decoded. `announce` is called with the path of each
    file before it is decoded. `masks` is a folder of masks that override those of
    the layout, `cameras` one of cameras that were found for photographs.
    """
    problems = Problems()
    manifest = collect_scene(folder, layout, problems, masks, cameras=cameras)
    if folder.is_dir():
        name = layout or detect_layout(folder)
        has_own = name is not None and LAYOUTS[name].own_files is not None
        known = reader_of(name).own_files(folder) if name is not None and has_own else set()
        note_unsupported(folder, known, problems)
        if name is not None:
            note_unread(folder, problems)
    if manifest is None:
        report = scene_pb2.SceneReport(usable=False, layout=layout or "", findings=problems.findings())
        return Inspection(report=report)
    seen = Problems()
    broken = _look_at_pictures(folder, manifest, skip, announce, seen)
    tolerant = manifest.layout not in BENCHMARKS
    if broken and tolerant and are_few(len(broken), len(manifest.frames) - len(broken)):
        problems = Problems()
        manifest = collect_scene(folder, layout, problems, masks, broken, cameras)
        note_unsupported(folder, set(), problems)
        note_unread(folder, problems)
    else:
        for finding in broken.values():
            problems.error(finding.code, finding.message, finding.subject)
        broken = {}
    problems.extend(seen)
    if manifest is not None and problems.usable and not photographs.lacks_cameras(manifest.frames):
        announce("")
        check_silhouettes(training_silhouettes(folder, manifest, problems), problems)
    frames = [] if manifest is None else list(manifest.frames)
    trained = sum(frame.split == scene_pb2.SPLIT_TRAIN for frame in frames)
    report = scene_pb2.SceneReport(
        usable=problems.usable,
        layout=layout or "" if manifest is None else manifest.layout,
        findings=problems.findings(),
        num_train_frames=trained,
        num_test_frames=len(frames) - trained,
    )
    return Inspection(report=report, manifest=manifest, left_out=tuple(broken))


def note_unsupported(folder: Path, known: set[Path], problems: Problems) -> None:
    """Note files in `folder`, but for `known`, that no capture should hold: programs, pickles, models."""
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and p not in known):
        if path.is_symlink() and not leads_inside(path, folder):
            continue
        kind = UNSUPPORTED_SUFFIXES.get(path.suffix.lower())
        if kind is None:
            try:
                with path.open("rb") as file:
                    start = file.read(4)
            except OSError as error:
                name = path.relative_to(folder).as_posix()
                problems.warning(
                    "scene.file_unreadable",
                    f"{name} cannot be opened ({error.strerror}); change its permissions",
                    name,
                )
                continue
            kind = next((k for magic, k in UNSUPPORTED_STARTS.items() if start.startswith(magic)), None)
        if kind is not None:
            name = path.relative_to(folder).as_posix()
            problems.warning(
                "scene.unsupported_file", f"{name} is {kind}; it is never loaded, so remove it", name
            )


def _look_at_pictures(
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    skip: Mapping[str, str],
    announce: Callable[[str], None],
    problems: Problems,
) -> dict[str, scene_pb2.Finding]:
    """Return what is wrong with photographs that cannot be used, by path; the rest goes to `problems`."""
    seen: dict[str, str] = {}
    masked = [False]
    broken = {}
    masks: dict[str, tuple[int, bool]] = {}
    doubts: dict[str, list[str]] = {}
    for frame in manifest.frames:
        for image in frame.images:
            announce(image.path)
            facts, fault = _look_at(folder, image.path, frame.name, skip)
            if facts is None:
                broken[image.path] = fault
                continue
            masked.append(facts.has_background)
            _note_facts(facts, image.path, frame.name, problems)
            if facts.colour_doubt:
                doubts.setdefault(facts.colour_doubt, []).append(image.path)
            _note_duplicate(folder, image.path, frame.name, seen, problems)
        for path in frame.truth.values():
            announce(path)
            facts, fault = _look_at(folder, path, frame.name, skip)
            if facts is None:
                problems.error(fault.code, fault.message, fault.subject)
            else:
                _note_facts(facts, path, frame.name, problems)
        if frame.mask:
            announce(frame.mask)
            masked.append(True)
            mask = _look_at_mask(folder, frame, skip, problems)
            if mask is not None:
                masks[frame.mask] = mask.full, mask.is_inverted
    _compare_masks(masks, problems)
    for doubt, paths in doubts.items():
        problems.warning(
            "scene.colour_profile",
            f"{listed(paths)}: each {doubt}; export again if they look wrong",
            paths[0],
        )
    if manifest.layout != PHOTOGRAPHS:
        _note_mirrored(folder, manifest, problems)
    without_cameras = photographs.lacks_cameras(manifest.frames)
    if not any(masked) and not without_cameras:
        problems.warning(
            "scene.no_mask",
            "no photograph has a transparent background and there are no masks, so training will have to "
            "guess where the object is (lambent masks shows how well); cut the object out and save PNG with "
            "alpha, or add masks, for a better result",
        )
    return broken


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


def _look_at_mask(
    folder: Path, frame: scene_pb2.Frame, skip: Mapping[str, str], problems: Problems
) -> Mask | None:
    if frame.mask in skip:
        code = skip[frame.mask]
        problems.error(code, f'{frame.mask} (frame "{frame.name}") {SKIPPED[code]}', frame.mask)
        return None
    try:
        mask = frame_mask(folder, frame)
        width, height = picture_size(folder / frame.images[0].path)
    except PictureError as error:
        problems.error(error.code, f'{frame.mask} (frame "{frame.name}") {error}', frame.mask)
        return None
    assert mask is not None
    coverage = mask.coverage
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
    return mask


def _note_mirrored(folder: Path, manifest: scene_pb2.SceneManifest, problems: Problems) -> None:
    """Refuse photographs that are stored as mirror images: their cameras may be those of either image."""
    mirrored = []
    for path in (image.path for frame in manifest.frames for image in frame.images):
        try:
            mirrored += [path] if exif_facts(folder / path).is_mirrored else []
        except PictureError:  # named where it was decoded
            continue
    if mirrored:
        problems.error(
            "scene.mirrored",
            f"{listed(mirrored)}: EXIF says that these are stored as mirror images, and nothing says whether "
            "their cameras were solved before or after mirroring them back; save them without the "
            "orientation, or give the photographs without cameras",
            mirrored[0],
        )


def _compare_masks(masks: Mapping[str, tuple[int, bool]], problems: Problems) -> None:
    """Note masks that are inverted, and those that are written otherwise than most of the capture's."""
    inverted = [path for path, (_, is_inverted) in masks.items() if is_inverted]
    upright = [path for path in masks if path not in inverted]
    if inverted and not upright:
        problems.warning(
            "scene.mask_inverted",
            f"all {len(inverted)} masks are white around the picture and black inside, so black is taken for "
            "the object; invert them if that is wrong",
            inverted[0],
        )
    elif inverted:
        odd, rest = sorted((inverted, upright), key=len)
        problems.error(
            "scene.mask_inverted",
            f"{listed(odd)}: {'black' if odd is inverted else 'white'} is the object here, and "
            f"{'white' if odd is inverted else 'black'} in {len(rest)} other masks; make them alike",
            odd[0],
        )
    levels = Counter(full for full, _ in masks.values() if full)
    if len(levels) > 1:
        common = levels.most_common(1)[0][0]
        odd = [path for path, (full, _) in masks.items() if full not in (0, common)]
        problems.error(
            "scene.mask_levels",
            f"{listed(odd)}: the object has the level {masks[odd[0]][0]} here, and {common} in other masks; "
            "save all with 0 for the background and 255 for the object",
            odd[0],
        )


def _look_at(
    folder: Path, path: str, frame: str, skip: Mapping[str, str]
) -> tuple[PictureFacts | None, scene_pb2.Finding]:
    """Return the facts about a picture, or None and what is wrong with it."""
    facts, code = None, skip.get(path, "")
    reason = SKIPPED.get(code, "")
    if not code:
        try:
            facts = picture_facts(folder / path)
            code, reason = "scene.image_not_finite", "holds NaN or infinity; export it again without"
        except PictureError as error:
            code, reason = error.code, str(error)
    if facts is not None and not facts.is_finite:
        facts = None
    return facts, scene_pb2.Finding(code=code, message=f'{path} (frame "{frame}") {reason}', subject=path)


def _note_facts(facts: PictureFacts, path: str, frame: str, problems: Problems) -> None:
    if facts.is_empty:
        problems.warning(
            "scene.image_empty", f'{path} (frame "{frame}") is fully transparent; leave the frame out', path
        )
