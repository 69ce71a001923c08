"""Reports as HTML pages that need no other file and no network, all of one look."""

from __future__ import annotations

import base64
from typing import NamedTuple

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from mapping.output.netcdf import software


class Picture(NamedTuple):
    """A picture of a page; `data_uri` holds its bytes."""

    name: str
    caption: str
    data_uri: str


def picture(name: str, caption: str, png: bytes) -> Picture:
    """Return a PNG picture that lies in the page itself."""
    data = base64.b64encode(png).decode("ascii")
    return Picture(name, caption, f"data:image/png;base64,{data}")


def render(package: str, template: str, **values: object) -> str:
    """Return a page.

    Args:
        package: whose `templates` folder holds the template, which extends page.html here.
        template: name of the template.
        values: what it shows; `title`, `verdict` (sentences) and `sha256` among it.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("mapping.output")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(software=software(), **values)
