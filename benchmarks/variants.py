"""Settings that a benchmark compares, as its options give them."""

import argparse


def add_variants(parser: argparse.ArgumentParser, of: str) -> None:
    """Add `--variant`; `of` says what a variant changes."""
    help_text = f"a name and the settings of {of} that differ from the preset, may be repeated"
    parser.add_argument(
        "--variant",
        action="append",
        type=variant,
        default=[],
        metavar="'NAME: KEY=VALUE ...'",
        help=help_text,
    )


def variant(text: str) -> tuple[str, dict[str, str]]:
    """Return name and settings of a variant, `NAME: KEY=VALUE KEY=VALUE`."""
    name, _, settings = text.partition(":")
    return name.strip(), dict(setting.split("=", 1) for setting in settings.split())
