# SPDX-License-Identifier: Apache-2.0
"""A web page in one file: text, tables and pictures, nothing from outside."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# default-src 'none': the page neither runs nor fetches anything, and a browser enforces it.
_HEAD = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff;
  max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }}
h1, h2 {{ line-height: 1.2; }}
h2 {{ margin-top: 2.5rem; border-bottom: 1px solid #bbb; }}
img {{ max-width: 100%; height: auto; }}
table {{ border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; }}
caption {{ text-align: left; font-weight: bold; padding: .2rem 0; }}
th, td {{ text-align: left; padding: .2rem 1rem .2rem 0; border-bottom: 1px solid #ddd;
  vertical-align: top; overflow-wrap: anywhere; }}
pre {{ background: #f4f4f4; padding: 1rem; overflow-x: auto; font-size: .85rem; }}
.note {{ color: #444; }}
</style>
</head>
<body>
"""


class Page:
    """Collects the parts of a page; every text given is escaped.

    Parameters
    ----------
    title : str
        Heading and title.
    """

    def __init__(self, title: str) -> None:
        self._parts = [_HEAD.format(title=escape(title)), f"<h1>{escape(title)}</h1>\n"]

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._parts.append(f"<h2>{escape(text)}</h2>\n")

    def paragraph(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f'<p class="note">{escape(text)}</p>\n')

    def table(
        self, rows: Sequence[Sequence[str]], caption: str = "", header: Sequence[str] = ()
    ) -> None:
        """Add a table whose first column names the rows."""
        head = f"<caption>{escape(caption)}</caption>\n" if caption else ""
        if header:
            cells = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in header)
            head += f"<thead><tr>{cells}</tr></thead>\n"
        body = "\n".join(
            f'<tr><th scope="row">{escape(first)}</th>'
            + "".join(f"<td>{escape(cell)}</td>" for cell in rest)
            + "</tr>"
            for first, *rest in rows
        )
        self._parts.append(f"<table>\n{head}<tbody>\n{body}\n</tbody>\n</table>\n")

    def figure(self, figure: Figure, text: str) -> None:
        """Add a picture with a text for who cannot see it."""
        from needle_sim_ros.view.style import styled

        data = BytesIO()
        with styled():
            figure.savefig(data, format="svg", metadata={"Date": None})
        address = f"data:image/svg+xml;base64,{b64encode(data.getvalue()).decode()}"
        self._parts.append(f'<p><img alt="{escape(text)}" src="{address}"></p>\n')

    def preformatted(self, text: str, summary: str) -> None:
        """Add text as it is, folded away under a summary."""
        self._parts.append(
            f"<details><summary>{escape(summary)}</summary>\n<pre>{escape(text)}</pre>\n</details>\n"
        )

    def html(self) -> str:
        """Return the whole page."""
        return "".join([*self._parts, "</body>\n</html>\n"])
