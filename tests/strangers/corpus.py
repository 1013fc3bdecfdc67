"""One capture for each kind of thing that strangers brought, with its right value in numbers.

The first part of a name is that of the report it stands for; letters after it are near kinds. A row either is
read right, or, where `or_said` is given, some finding says in these words why not; a row with `refused` must
be refused in these words.
"""

import json
import os
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from strangers import floats, profiles
from strangers.ball import (
    ANGLE,
    BALL,
    COUNT,
    COVER,
    FOCAL,
    GREY,
    SIDE,
    disc,
    levels,
    masked,
    names_of,
    save_png,
    save_rgba,
    view_light,
    write_masks,
    write_photographs,
    write_transforms,
)
from strangers.colours import SPACES, levels_of
from strangers.masks import MASKS
from strangers.models import write_model
from strangers.pictures import Spec, enlarged, save_levels, turned
from strangers.statements import STATEMENTS
from support.raw_files import write_dng

Make = Callable[[Path], None]


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """A capture and what is right about it."""

    make: Make
    light: tuple[float, float, float] | None = None
    """Mean linear Rec. 709 over the object of the first frame."""
    edge: tuple[float, float, float] | None = None
    """The same where it is covered by half."""
    alpha: float | None = None
    """Mean coverage of the first frame."""
    focal: tuple[float, float] = (FOCAL, FOCAL)
    centre: tuple[float, float] = (SIDE / 2, SIDE / 2)
    count: int = COUNT
    has_cameras: bool = True
    needs: tuple[str, ...] = ()
    """Codes of findings that are there."""
    lacks: tuple[str, ...] = ()
    """Codes of findings that are not."""
    or_said: tuple[str, ...] = ()
    """Words of a finding that excuse another reading; any of them."""
    says: tuple[str, ...] = ()
    """Words that findings hold, each."""
    refused: tuple[str, ...] = ()
    """Words of which each is in the error."""


ROWS: dict[str, Row] = {}


def _row(name: str, make: Make, **right: object) -> None:
    assert name not in ROWS, name
    ROWS[name] = Row(make=make, **right)  # type: ignore[arg-type]


def _posed(save: Callable = save_png, suffix: str = ".png", **options: object) -> Make:
    return lambda folder: write_transforms(folder, names_of(suffix), save, **options)  # type: ignore[arg-type]


# Layouts: transforms files.
_row("a00 base", _posed(), light=BALL)
_row("a00b blender", _posed(save_rgba, file="transforms_train.json"), light=BALL, alpha=COVER)
_row("a01 backslash", _posed(named=lambda name: name.replace("/", "\\")), light=BALL)
_row("a01b dot backslash", _posed(named=lambda name: ".\\" + name.replace("/", "\\")))
_row("a01c dot slash", _posed(named=lambda name: "./" + name))
_row(
    "a01d backslash mask",
    lambda folder: (
        write_transforms(folder, frame={"mask_path": lambda index: f"masks\\{index:03d}.png"}),
        write_masks(folder, names_of(folder="masks/"), MASKS["255"][1]),
    )[0],
    alpha=COVER,
)
_CENTRE = {"camera_angle_x": ANGLE, "cx": 36.0, "cy": 30.0, "w": SIDE, "h": SIDE}
_row("a05 angle with cx", _posed(lens=_CENTRE), centre=(36, 30))
_row("a05b blender angle with cx", _posed(lens=_CENTRE, file="transforms_train.json"), centre=(36, 30))
_row("a05c centre per frame", _posed(frame={"cx": 36.0, "cy": 30.0}), centre=(36, 30))
_row(
    "a05d size twice as large",
    _posed(lens={"fl_x": 2 * FOCAL, "fl_y": 2 * FOCAL, "cx": 72, "cy": 60, "w": 128, "h": 128}),
    centre=(36, 30),
)
_row(
    "a05e angle with cx of a picture twice as large",
    _posed(lens={"camera_angle_x": ANGLE, "cx": 72, "cy": 60, "w": 128, "h": 128}),
    centre=(36, 30),
)
_row(
    "a06 angle of the frame over the file's length",
    _posed(
        lens={"fl_x": 80.0, "fl_y": 80.0, "cx": 32, "cy": 32, "w": SIDE, "h": SIDE},
        frame={"camera_angle_x": ANGLE},
    ),
)
_row("a06b length of the frame over the file's angle", _posed(frame={"fl_x": 120.0}), focal=(120, 120))
_row(
    "a06c both in the file",
    _posed(lens={"fl_x": 120.0, "camera_angle_x": ANGLE}),
    focal=(120, 120),
)
_row(
    "a06d both in the frame",
    _posed(frame={"fl_x": 120.0, "fl_y": 110.0, "camera_angle_x": 1.2}),
    focal=(120, 110),
)
_ANGLE_Y = 2.0 * np.arctan(SIDE / 2 / 120.0)
_row(
    "a07 angle y",
    _posed(lens={"camera_angle_x": ANGLE, "camera_angle_y": _ANGLE_Y}),
    focal=(FOCAL, 120),
)
_row("a07b angle y alone", _posed(lens={"camera_angle_y": _ANGLE_Y}), focal=(120, 120))
_row("a07c fl_y beside angle x", _posed(lens={"camera_angle_x": ANGLE, "fl_y": 120.0}), focal=(FOCAL, 120))


def _bom(folder: Path) -> None:
    write_transforms(folder)
    file = folder / "transforms.json"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())


_row("a15 byte order mark", _bom, light=BALL)


def _bom_blender(folder: Path) -> None:
    write_transforms(folder, file="transforms_train.json")
    file = folder / "transforms_train.json"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())


_row("a15b byte order mark of blender", _bom_blender)
_row(
    "a17 case of the suffix",
    _posed(suffix=".png", named=lambda name: name[:-3] + "PNG"),
    or_said=("000.png",),
)
_row(
    "a17b case of the file", _posed(suffix=".PNG", named=lambda name: name[:-3] + "png"), or_said=("000.PNG",)
)
_row(
    "a17c case of the folder",
    _posed(named=lambda name: name.replace("images", "Images")),
    or_said=("images/000.png",),
)


def _accents(folder: Path) -> None:
    names = [f"images/été {index}.png" for index in range(COUNT)]
    write_transforms(
        folder,
        [unicodedata.normalize("NFD", name) for name in names],
        named=lambda name: unicodedata.normalize("NFC", name),
    )


_row("a17d decomposed letters", _accents)
_row("a17e no suffix", _posed(named=lambda name: name[:-4]))
_row(
    "a17f doubled suffix",
    lambda folder: write_transforms(folder, names_of(".png.png"), named=lambda name: name[:-4]),
)
_row(
    "a17g suffix of another format",
    _posed(suffix=".png", named=lambda name: name[:-3] + "jpg"),
    or_said=("000.png",),
)


def _three_rows(folder: Path) -> None:
    write_transforms(folder)
    file = folder / "transforms.json"
    record = json.loads(file.read_text())
    for frame in record["frames"]:
        frame["transform_matrix"] = frame["transform_matrix"][:3]
    file.write_text(json.dumps(record))


_row("a19 matrices of three rows", _three_rows)


def _shifted(offset: tuple[float, float, float]) -> Make:
    def make(folder: Path) -> None:
        write_transforms(folder, frame={"mask_path": lambda index: f"masks/{index:03d}.png"})
        write_masks(folder, names_of(folder="masks/"), MASKS["255"][1])
        file = folder / "transforms.json"
        record = json.loads(file.read_text())
        for frame in record["frames"]:
            for axis in range(3):
                frame["transform_matrix"][axis][3] += offset[axis]
        file.write_text(json.dumps(record))

    return make


_row("a51 a little aside", _shifted((100.0, -20.0, 3.0)), alpha=COVER)
_row("a51b UTM", _shifted((4.5e5, 5.1e6, 120.0)), alpha=COVER, lacks=("scene.silhouettes_disagree",))
_row("a51c ECEF", _shifted((4_186_000.0, 834_000.0, 4_723_000.0)), alpha=COVER)


def _below(folder: Path) -> None:
    write_transforms(folder / "capture")


_row("a59 one folder too high", _below, or_said=("transforms.json",))

# Layouts: COLMAP.


def _colmap(place: str, *, images: str = "images/", model: dict | None = None) -> Make:
    def make(folder: Path) -> None:
        names = names_of(folder="")
        write_photographs(folder, [images + name for name in names])
        write_model(folder / place, names, **(model or {}))

    return make


def _two_models(folder: Path) -> None:
    _colmap("sparse/1")(folder)
    write_model(folder / "sparse" / "0", names_of(folder="")[:3])


_row("a18 new camera model", _colmap("sparse/0", model={"model": 12}), refused=("undistort",))
_row(
    "a18b new camera model as text",
    _colmap("sparse/0", model={"binary": False, "kind": "SIMPLE_DIVISION"}),
    refused=("undistort",),
)
_row("a20 two models", _two_models, or_said=("sparse/1",))
_row("a20b the second model alone", _colmap("sparse/1"))
_row("a20c model in sparse", _colmap("sparse"))
_row("a20d colmap/sparse/0", _colmap("colmap/sparse/0"))
_row("a20e model at the root", _colmap(".", model={"binary": False}))
_row("a20f sparse/0", _colmap("sparse/0"), light=BALL)

# Layouts: photographs with what lies beside them.


def _polycam(folder: Path) -> None:
    from support.captures import ring

    frames = folder / "keyframes"
    stems = [str(1_000_000 + 37 * index) for index in range(COUNT)]
    for kind in ("images", "corrected_images", "depth", "confidence"):
        suffix = ".jpg" if "images" in kind else ".png"
        write_photographs(
            frames / kind, [stem + suffix for stem in stems], _jpeg() if "images" in kind else save_png
        )
    for kind in ("cameras", "corrected_cameras"):
        (frames / kind).mkdir()
        for stem, pose in zip(stems, ring(COUNT), strict=True):
            record = {"fx": FOCAL, "fy": FOCAL, "cx": 32, "cy": 32, "width": SIDE, "height": SIDE}
            record |= {f"t_{row}{column}": pose[row, column] for row in range(3) for column in range(4)}
            (frames / kind / f"{stem}.json").write_text(json.dumps(record))
    (folder / "mesh_info.json").write_text("{}")
    write_photographs(folder, ["thumbnail.jpg"], _jpeg())


def _jpeg(**options: object) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del alpha
        Image.fromarray(levels(colours)).save(path, "JPEG", quality=98, subsampling=0, **options)

    return save


def _raw_beside(photograph: str, raw: str) -> Make:
    """Return a writer of shots that a camera saved twice; raw files are read at half their size."""

    def make(folder: Path) -> None:
        for index in range(COUNT):
            colours = view_light(index)
            _jpeg()(folder / photograph.format(index), colours, disc())
            write_dng(folder / raw.format(index), enlarged(colours, 2))

    return make


def _with_masks(pictures: str, masks: str, *, mask: str = "255") -> Make:
    """Return a writer of photographs and masks; `{}` in the names becomes their number."""

    def make(folder: Path) -> None:
        save = save_png if pictures.endswith("png") else _jpeg()
        numbers = [f"{index:03d}" for index in range(COUNT)]
        write_photographs(folder, [pictures.format(number) for number in numbers], save)
        write_masks(folder, [masks.format(number) for number in numbers], MASKS[mask][1])

    return make


_row("a22 polycam", _polycam)
_PIXEL = "PXL_20240101_1200{:02d}000.RAW-0"
_row(
    "a23 pixel raw",
    _raw_beside(_PIXEL + "1.COVER.jpg", _PIXEL + "2.ORIGINAL.dng"),
    has_cameras=False,
    needs=("scene.saved_twice",),
)
_row(
    "a23b raw and jpeg",
    _raw_beside("IMG_{:04d}.JPG", "IMG_{:04d}.dng"),
    has_cameras=False,
    needs=("scene.saved_twice",),
)
_MASKED = {"alpha": COVER, "has_cameras": False}
_row("a40 masks beside", _with_masks("IMG_{}.jpg", "masks/IMG_{}.png"), **_MASKED)
_row("a40b image and mask", _with_masks("image/IMG_{}.jpg", "mask/IMG_{}.png"), **_MASKED)
_row("a40c images and masks", _with_masks("images/IMG_{}.jpg", "masks/IMG_{}.png"), **_MASKED)
_row("a40d suffix _mask", _with_masks("IMG_{}.jpg", "IMG_{}_mask.png"), **_MASKED)
_row("a40e images_masks", _with_masks("images/IMG_{}.jpg", "images_masks/IMG_{}.png"), **_MASKED)
_row("a40f mask beside", _with_masks("IMG_{}.jpg", "mask/IMG_{}.png"), **_MASKED)
_row("a40g masks of 0 and 1", _with_masks("images/IMG_{}.jpg", "masks/IMG_{}.png", mask="01"), **_MASKED)


def _linked_folder(folder: Path) -> None:
    write_transforms(folder)
    (folder / "images").rename(folder / "photographs")
    (folder / "images").symlink_to("photographs")


def _linked_files(folder: Path) -> None:
    write_transforms(folder)
    (folder / "images").rename(folder / "store")
    (folder / "images").mkdir()
    for path in (folder / "store").iterdir():
        (folder / "images" / path.name).symlink_to(Path("..") / "store" / path.name)


def _linked_outside(folder: Path) -> None:
    write_transforms(folder)
    outside = folder.with_name(folder.name + "-outside")
    (folder / "images").rename(outside)
    (folder / "images").symlink_to(os.path.relpath(outside, folder))


_row("a42 linked folder", _linked_folder)
_row("a42d linked files", _linked_files)
_row("a42e linked from outside", _linked_outside, refused=("link",))

# Masks.
for _kind in (
    "01",
    "labels",
    "1 bit",
    "16 bit",
    "16 bit 01",
    "palette",
    "palette labels",
    "palette 1 bit",
    "inverted",
    "inverted 01",
    "inverted 16 bit",
    "alpha white",
    "alpha black",
    "colours",
    "webp",
    "tiff",
):
    _excuse = ("invert", "white is the object") if "inverted" in _kind else ()
    _row(
        f"a{'09' if 'palette' in _kind else '08'} mask {_kind}",
        masked(MASKS[_kind][1], MASKS[_kind][0]),
        alpha=COVER,
        or_said=_excuse,
    )

# Pictures: EXR.


def _exr(**options: object) -> Callable:
    """Return a writer of half floats; `alpha` is none, straight or premultiplied."""
    alpha_is = str(options.pop("alpha", "none"))
    space = SPACES[str(options.pop("space", "linear"))]
    layer = str(options.pop("layer", ""))
    stated = space if space.name != "linear" else None

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        values = levels_of(colours, space)
        if alpha_is == "premultiplied":
            values = values * alpha[..., None]
        planes = {layer + name: values[..., index].astype(np.float16) for index, name in enumerate("RGB")}
        if alpha_is != "none":
            planes[layer + "A"] = alpha.astype(np.float16)
        floats.write_exr(path, planes, space=stated, **options)  # type: ignore[arg-type]

    return save


def _soft_exr(rim: float) -> Callable:
    """Return a writer of premultiplied colours whose outline is half covered, and so much brighter."""

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        rows, columns = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
        radius = np.hypot(rows, columns)
        alpha = np.where(radius <= 16.0, 1.0, np.where(radius <= 20.0, 0.5, 0.0))
        edge = ((radius > 16.0) & (radius <= 20.0))[..., None]
        _exr(alpha="premultiplied")(path, np.where(edge, rim * colours, colours), alpha)

    return save


def _window(grow: int) -> Callable:
    """Return a writer whose stored pixels reach `grow` pixels beyond the frame on each side; less with < 0."""

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        if grow > 0:
            colours = np.pad(colours, ((grow, grow), (grow, grow), (0, 0)), mode="edge")
            alpha = np.pad(alpha, grow)
        else:
            part = slice(-grow, grow)
            colours, alpha = colours[part, part], alpha[part, part]
        writer = _exr(alpha="premultiplied", data_at=(-grow, -grow), display=(SIDE, SIDE))
        writer(path, colours, alpha)

    return save


def _luminance_chroma(sampling: int) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del alpha
        y = colours @ np.array([0.2126, 0.7152, 0.0722])
        planes = {"Y": (y, 1)}
        for name, channel in (("RY", 0), ("BY", 2)):
            planes[name] = ((colours[..., channel] / y - 1.0)[::sampling, ::sampling], sampling)
        floats.write_subsampled_exr(path, planes)

    return save


def _parts(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    depth = {"depth": {"Z": np.ones((SIDE, SIDE), np.float32)}}
    small = {"thumbnail": {name: np.zeros((8, 8), np.float16) for name in "RGB"}}
    _exr(alpha="premultiplied", extra_parts={**depth, **small})(path, colours, alpha)


def _integers(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    del alpha
    values = np.round(255 * colours).astype(np.uint32)
    floats.write_exr(path, {name: values[..., index] for index, name in enumerate("RGB")})


_CUT = {"light": BALL, "alpha": COVER}
_row("a11 exr premultiplied", _posed(_soft_exr(1.0), ".exr"), light=BALL, alpha=0.2534)
_row(
    "a11d exr premultiplied with a bright rim",
    _posed(_soft_exr(2.0), ".exr"),
    edge=(1.2, 0.4, 0.2),
    alpha=0.2534,
    or_said=("straight",),
)
_row("a11e exr premultiplied, its outline", _posed(_soft_exr(1.0), ".exr"), edge=BALL, alpha=0.2534)
_row("a11c exr without alpha", _posed(_exr(), ".exr"), light=BALL)
_row("a12 exr data window", _posed(_window(-10), ".exr"), **_CUT, or_said=("window",))
_row("a12b exr overscan", _posed(_window(4), ".exr"), **_CUT, or_said=("window",))
for _name in ("ap1", "ap0", "rec2020-linear", "p3-linear"):
    _row(f"a13 exr {_name}", _posed(_exr(space=_name), ".exr"), light=BALL)
_row("a14 exr luminance chroma", _posed(_luminance_chroma(2), ".exr"), light=BALL, or_said=("Y",))
_row("a14b exr luminance chroma everywhere", _posed(_luminance_chroma(1), ".exr"), light=BALL, or_said=("Y",))
_row("a14c exr parts", _posed(_parts, ".exr"), **_CUT)
_row("a14d exr layer", _posed(_exr(alpha="premultiplied", layer="ViewLayer.Combined."), ".exr"), **_CUT)
_row("a14e exr integers", _posed(_integers, ".exr"), refused=("integer", "000.exr"))

# Pictures: formats.


def _tiff(full: int = 255, **options: object) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        import tifffile

        del alpha
        tifffile.imwrite(path, levels(colours, full=full), photometric="rgb", metadata=None, **options)

    return save


def _float_tiff(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    import tifffile

    del alpha
    tifffile.imwrite(path, colours.astype(np.float32), photometric="rgb", metadata=None)


def _mixed(suffix: str, save: Callable) -> Make:
    def make(folder: Path) -> None:
        write_photographs(folder, [f"IMG_{index:03d}.jpg" for index in range(COUNT // 2)], _jpeg())
        rest = [f"IMG_{index:03d}{suffix}" for index in range(COUNT // 2, COUNT)]
        write_photographs(folder, rest, save)

    return make


def _format(name: str) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del alpha
        Image.fromarray(levels(colours)).save(path, name)

    return save


def _avif(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    del alpha
    Image.fromarray(levels(colours)).save(path, "AVIF", quality=100, subsampling="4:4:4")


_row("a16 tiff", _posed(_tiff(), ".tif"), light=BALL, or_said=("TIFF",))
_row("a16d tiff lzw", _posed(_tiff(compression="lzw"), ".tiff"), light=BALL, or_said=("TIFF",))
_row("a16e tiff 16 bit zip", _posed(_tiff(65535, compression="zlib"), ".tif"), light=BALL, or_said=("TIFF",))
_row("a16f tiff of floats", _posed(_float_tiff, ".tif"), light=BALL, or_said=("TIFF",))
_row("a16b tiff beside jpeg", _mixed(".tif", _tiff()), has_cameras=False, or_said=("4 .tif", ".tif"))
_row("a16c avif", _mixed(".avif", _avif), has_cameras=False, or_said=(".avif",))
_row("a16g avif named", _posed(_avif, ".avif"), light=BALL, or_said=("AVIF",))
_row("a16h bmp beside jpeg", _mixed(".bmp", _format("BMP")), has_cameras=False, or_said=(".bmp",))
_row("a16i gif named", _posed(_format("GIF"), ".gif"), refused=("GIF",))
_row(
    "a16j bmp alone",
    lambda folder: write_photographs(folder, names_of(".bmp", ""), _format("BMP")),
    refused=(".bmp",),
)

# Pictures: colours.


def _stated(kind: str, colour: str, *, full: int = 255) -> Callable:
    """Return a writer of a format with a statement of colours from `STATEMENTS`."""
    statement = STATEMENTS[kind][colour]
    space = statement.means[0] if statement.means else SPACES["rec2020-srgb"]
    spec = Spec(format=kind, colour=colour, depth="16" if full > 255 else "8")

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        save_levels(path, levels(colours, space, full), alpha, spec, statement)

    return save


for _id, _kind, _suffix, _colour in (
    ("a24", "jpeg", ".jpg", "exif r03"),
    ("a24b", "jpeg", ".jpg", "none"),
    ("a24c", "jpeg", ".jpg", "exif uncalibrated"),
    ("a24d", "jpeg", ".jpg", "icc p3 over r03"),
    ("a24e", "jpeg", ".jpg", "icc adobe"),
    ("a24f", "webp", ".webp", "icc prophoto"),
    ("a24g", "tiff", ".tif", "icc adobe"),
    ("a26", "png", ".png", "gama 1"),
    ("a26b", "png", ".png", "gama chrm adobe"),
    ("a26c", "png", ".png", "cicp p3"),
    ("a26d", "png", ".png", "cicp over all"),
    ("a26e", "png", ".png", "iccp over srgb"),
    ("a26f", "png", ".png", "srgb over gama"),
    ("a26g", "png", ".png", "gama chrm linear 2020"),
    ("a29", "heic", ".heic", "nclx p3"),
    ("a29b", "avif", ".avif", "nclx p3"),
    ("a29c", "heic", ".heic", "icc adobe over nclx p3"),
):
    _row(
        f"{_id} {_kind} {_colour}",
        _posed(_stated(_kind, _colour), _suffix),
        light=BALL,
        or_said=("AVIF",) if _kind == "avif" else ("TIFF",) if _kind == "tiff" else (),
    )
_row("a26h png 16 bit p3", _posed(_stated("png", "iccp p3", full=65535)), light=BALL)
for _id, _kind, _suffix, _colour, _word in (
    ("a29e", "heic", ".heic", "nclx pq", "PQ"),
    ("a29f", "heic", ".heic", "nclx hlg", "HLG"),
    ("a29g", "avif", ".avif", "nclx pq", "PQ"),
    ("a26i", "png", ".png", "cicp pq", "PQ"),
    ("a26j", "png", ".png", "cicp hlg", "HLG"),
):
    _row(f"{_id} {_kind} {_colour}", _posed(_stated(_kind, _colour), _suffix), refused=(_word, "000"))


def _radiance(space: str, *header: str, rows: str = "-Y", scale: float = 1.0) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del alpha
        values = levels_of(colours, SPACES[space]) * scale
        lines = (*STATEMENTS["hdr"][space].header, *header)
        floats.write_hdr(path, floats.rgbe(values), header=lines, rows=rows)

    return save


_row("a30 hdr", _posed(_radiance("linear"), ".hdr"), light=BALL)
_row("a30b hdr 2020", _posed(_radiance("rec2020-linear"), ".hdr"), light=BALL)
_row("a30c hdr exposure", _posed(_radiance("linear", "EXPOSURE=2.0", scale=2.0), ".hdr"), light=BALL)

# Pictures: alpha.


def _palette(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    ball, grey = (levels(np.array([value])).tobytes() for value in (BALL, (GREY,) * 3))
    index = (alpha > 0).astype(np.uint8)
    path.write_bytes(profiles.png(index, profiles.chunk(b"tRNS", b"\0\xff"), palette=grey + ball))


def _opaque_palette(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    ball, grey = (levels(np.array([value])).tobytes() for value in (BALL, (GREY,) * 3))
    path.write_bytes(profiles.png((alpha > 0).astype(np.uint8), palette=grey + ball))


def _key(full: int, *, grey: bool = False) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        stored = levels(colours[..., :1] if grey else colours, SPACES["srgb"] if not grey else None, full)
        stored = np.where(alpha[..., None] > 0, stored, full).astype(stored.dtype)
        key = full.to_bytes(2, "big") * stored.shape[-1]
        path.write_bytes(profiles.png(stored, profiles.chunk(b"tRNS", key)))

    return save


_KEPT = {**_CUT, "lacks": ("scene.no_mask",)}
_row("a28 palette with tRNS", _posed(_palette), **_KEPT)
_row("a28b colour key", _posed(_key(255)), **_KEPT)
_row("a28c colour key 16 bit", _posed(_key(65535)), **_KEPT)
_row("a28f palette without tRNS", _posed(_opaque_palette), light=BALL, needs=("scene.no_mask",))
_row("a28g rgba", _posed(save_rgba), **_KEPT)

# Orientation.


_LEFT = np.arange(SIDE)[None] < SIDE / 2
_HEIGHT = SIDE - 16


def _turned(orientation: int) -> Make:
    """Return a writer of photographs with an EXIF orientation whose masks were painted upright.

    They show the left half of the ball, and lack the lower rows.
    """
    block = profiles.exif(orientation=orientation)

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del colours
        _jpeg(exif=block)(
            path, np.where(_LEFT[..., None] & (disc() > 0)[..., None], BALL, 0.02)[:_HEIGHT], alpha
        )

    def mask(path: Path, alpha: np.ndarray) -> None:
        MASKS["255"][1](path, turned(np.where(_LEFT, alpha, 0.0)[:_HEIGHT], orientation))

    def make(folder: Path) -> None:
        frame = {"mask_path": lambda index: f"masks/{index:03d}.png"}
        write_transforms(folder, names_of(".jpg"), save, frame=frame)
        write_masks(folder, names_of(folder="masks/"), mask)

    return make


for _orientation in (3, 6, 8):
    _row(
        f"a31 orientation {_orientation} with upright masks",
        _turned(_orientation),
        light=BALL,
        alpha=0.1950,
        focal=(FOCAL, FOCAL),
        centre=(SIDE / 2, SIDE / 2 - 8),
    )


def _mirrored(folder: Path) -> None:
    write_photographs(folder, names_of(".jpg", ""), _jpeg(exif=profiles.exif(orientation=2)))


_row("a31b mirrored", _mirrored, has_cameras=False, says=("mirror",))
