"""Help in sections: a verb's own options first, then those that many verbs share."""

from __future__ import annotations

import click

from orograph.cli.camera import CAMERA
from orograph.cli.scenes import DETAILS
from orograph.scene.parts import HOMES

PARTS = {
    "lighting": "Light",
    "data": "Colours, layers, water",
    "theme": "Data on the ground",
    "annotations": "Lines and furniture",
    "surface": "Surface and method",
}
"""Sections of a scene's options, by part."""

READING = (
    "bbox", "clip", "crs", "resolution", "resampling", "band", "nodata", "spacing", "assume_crs", "encoding",
    "vertical_unit", "assume_vertical", "to_vertical", "geoid", "max_edge", "height_column", "point_layer",
    "point_classes",
)  # fmt: skip

SECTION = {
    **dict.fromkeys(CAMERA, "Camera"),
    **{name: PARTS[part] for name, part in HOMES.items() if part in PARTS},
    **{detail: PARTS[HOMES[name]] for name, details in DETAILS.items() for detail in details},
    "uncertainty": PARTS["theme"],
    "conservative": PARTS["surface"],
    "backend": PARTS["surface"],
    **dict.fromkeys(READING, "Reading the files"),
    **dict.fromkeys(("max_memory", "jobs"), "Resources"),
}
"""The section of an option, by the name of its argument; the rest are a verb's own."""

TITLES = ("Options", "Camera", *PARTS.values(), "Reading the files", "Resources")

LONG = 20
"""Options whose help has sections."""


class Verb(click.Command):
    """A command whose help has sections if it is long."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        records = ((param, param.get_help_record(ctx)) for param in self.get_params(ctx))
        listed = [(param, record) for param, record in records if record and record[1]]  # (arguments have no help)
        sections: dict[str, list[tuple[str, str]]] = {title: [] for title in TITLES}
        for param, record in listed:
            own = len(listed) < LONG
            sections["Options" if own else SECTION.get(str(param.name), "Options")].append(record)
        for title, rows in sections.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)
