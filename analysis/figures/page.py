"""Pieces of HTML that the chapters of a report share."""

import base64
import io
from html import escape
from pathlib import Path

from drivers.arrays import FloatArray


def figure(panels: list[str], caption: str, kind: str = "") -> str:
    """Panels of SVG side by side, or one below another, with a caption of HTML."""
    return f'<figure><div class="panels {kind}">{"".join(panels)}</div><figcaption>{caption}</figcaption></figure>'


def png(image: FloatArray) -> str:
    """An image [rows, columns, 3 or 4], display-encoded from 0 to 1, as a PNG file in base64."""
    from matplotlib.image import imsave  # noqa: PLC0415  (takes a second)

    file = io.BytesIO()
    imsave(file, image, format="png")
    return base64.b64encode(file.getvalue()).decode()


def image_panel(image: FloatArray, words: str) -> str:
    """An image [rows, columns, 3 or 4], display-encoded from 0 to 1, with words below it."""
    data = png(image)
    return (
        f'<div><img alt="{escape(words)}" style="width:100%;image-rendering:pixelated" '
        f'src="data:image/png;base64,{data}"><div class="soft">{escape(words)}</div></div>'
    )


def bullets(items: list[str] | tuple[str, ...]) -> str:
    """A list of plain sentences; nothing for no items."""
    return f"<ul>{''.join(f'<li>{escape(item)}</li>' for item in items)}</ul>" if items else ""


def page(title: str, body: list[str]) -> str:
    """A self-contained page of pieces of HTML, light or dark as the reader's system is."""
    style = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>\n{style}</style>\n</head>\n<body>\n<main>\n" + "\n".join(body) + "\n</main>\n</body>\n</html>\n"
    )


def titled_page(title: str, body: list[str]) -> str:
    """The same under its title."""
    return page(title, [f"<h1>{escape(title)}</h1>", *body])
