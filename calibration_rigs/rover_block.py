"""The output of a calibration whose result is a block of rover.toml.

Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import argparse
from typing import Protocol

from acquisition.commands.arguments import product
from acquisition.commands.console import Console, Describable, show


class Block(Describable, Protocol):
    """A result that rover.toml can hold."""

    def toml(self) -> str:
        """Return the block."""


def add_block_output(parser: argparse.ArgumentParser) -> None:
    """Declare where the block goes."""
    parser.add_argument(
        "-o",
        "--output",
        type=product(".toml"),
        required=True,
        metavar="FILE.toml",
        help="a block to put into rover.toml",
    )


def check_block_output(options: argparse.Namespace) -> None:
    """Refuse an output that cannot be written, before the recording is read.

    Raises:
        StreamError: it cannot.
    """
    from acquisition.files import check_target

    check_target(options.output)


def write_block(options: argparse.Namespace, console: Console, result: Block) -> None:
    """Write the block, and print the result in the form that was asked for.

    Raises:
        MappingError: the file cannot be written.
    """
    from mapping.files import write_whole

    write_whole(options.output, result.toml().encode())
    show(console, result, as_json=options.json)
