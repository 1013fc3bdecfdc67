"""Errors of relighting that a user can act on."""


class RelightError(Exception):
    """An error a user can fix: a stable `code`, what was found, and what to do about it.

    `str(error)` is `code: message; advice`, one line for a terminal. `code` is part of the public
    interface and never changes its meaning.
    """

    def __init__(self, code: str, message: str, advice: str) -> None:
        super().__init__(f"{code}: {message}; {advice}")
        self.code = code
        self.message = message
        self.advice = advice


class BundleError(RelightError):
    """A bundle is damaged, unsafe, or of an unsupported version. Codes start with `bundle.`."""


class EnvironmentFileError(RelightError):
    """An environment map cannot be used. Codes start with `environment.`."""


class CameraError(RelightError):
    """A camera description cannot be used. Codes start with `camera.`."""


class ExportError(RelightError):
    """An asset cannot be written in a format. Codes start with `export.`."""


class SettingError(RelightError, ValueError):
    """A setting of a render is out of range. Codes start with `relight.`."""


class UnsupportedQuality(RelightError):  # noqa: N818 - the quality is at fault, not the program
    """The requested quality is not supported by this version or by this bundle.

    Codes `relight.quality_unsupported` and `relight.networks_missing`.
    """
