"""Pieces of HTML that the chapters of a report share."""

from html import escape


def figure(panels: list[str], caption: str, kind: str = "") -> str:
    """Panels of SVG side by side, or one below another, with a caption of HTML."""
    return f'<figure><div class="panels {kind}">{"".join(panels)}</div><figcaption>{caption}</figcaption></figure>'


def bullets(items: list[str] | tuple[str, ...]) -> str:
    """A list of plain sentences; nothing for no items."""
    return f"<ul>{''.join(f'<li>{escape(item)}</li>' for item in items)}</ul>" if items else ""
