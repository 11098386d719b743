"""A report as PDF, set by typst. Every word is handed over as a string literal, so that nothing in it is read as markup."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from .legend import INKS
from .report_document import Document, Figure, Part, Table, Words

HEAD = """#set page(paper: "a4", margin: (x: 18mm, y: 18mm), numbering: "1 / 1", footer-descent: 6mm)
#set text(font: ("Libertinus Serif",), size: 10pt)
#set par(justify: false, leading: 0.62em)
#show heading.where(level: 1): it => block(above: 0pt, below: 10pt, text(size: 17pt, weight: "semibold", it.body))
#show heading.where(level: 2): it => block(above: 20pt, below: 8pt, width: 100%, stroke: (bottom: 0.5pt + gray), inset:
(bottom: 4pt),
  text(size: 12.5pt, weight: "semibold", it.body))
#show table: set text(size: 7.8pt)
#set figure(gap: 6pt)
#set table(stroke: (x, y) => if y == 0 { (bottom: 0.6pt) }, inset: (x: 3pt, y: 2pt))
#show figure.caption: set text(size: 8.5pt, fill: luma(35%))
"""


def pdf(document: Document) -> bytes:
    """The PDF."""
    import typst

    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "report.typ").write_text(_source(document, Path(folder)), encoding="utf-8")
        return typst.compile(str(Path(folder) / "report.typ"), root=folder)


def _source(document: Document, folder: Path) -> str:
    facts = "".join(f"text(fill: luma(40%), {_string(k)}), {_string(v)}, " for k, v in document.facts.items())
    lines = [HEAD, f"#set document(title: {_string(document.title)})", f"#heading(level: 1, {_string(document.title)})",
             f"#grid(columns: (auto, 1fr), column-gutter: 10pt, row-gutter: 5pt, {facts})"]
    count = 0
    for section in document.sections:
        lines.append(f"#heading(level: 2, {_string(section.title)})")
        for part in section.parts:
            if isinstance(part, Figure):
                (folder / f"figure-{count}.svg").write_text(part.svg, encoding="utf-8")
            lines.append(_part(part, f"figure-{count}.svg"))
            count += isinstance(part, Figure)
    return "\n".join(lines)


def _part(part: Part, file: str) -> str:
    if isinstance(part, Figure):
        width = 100 if part.wide else 62
        return f"#figure(image({_string(file)}, width: {width}%), caption: text({_string(part.caption)}), supplement: none)"
    if isinstance(part, Table):
        return _table(part)
    return _words(part)


def _words(words: Words) -> str:
    text = f"text({_string(words.text)})"
    if words.kind == "warning":
        return f"#block(width: 100%, inset: (left: 8pt, y: 3pt), stroke: (left: 2pt + rgb(\"{INKS['residual']}\")), {text})"
    if words.kind == "statement":
        return f"#block(width: 100%, inset: (left: 8pt, y: 4pt), stroke: (left: 2pt + rgb(\"{INKS['perspective']}\")), {text})"
    return f"#par(text(size: 9pt, {_string(words.text)}))" if words.kind == "note" else f"#par({text})"


def _table(table: Table) -> str:
    marked = ", ".join(str(k + 1) for k in sorted(table.marked))
    fill = f"fill: (x, y) => if y in ({marked},) {{ rgb(\"#FFF3E6\") }}, " if marked else ""
    align = ", ".join("right" if r else "left" for r in table.right)
    header = ", ".join(f"text(weight: \"semibold\", {_string(h)})" for h in table.header)
    cells = ", ".join(f"text({_string(str(cell))})" for row in table.rows for cell in row)
    bold = f"text(weight: \"semibold\", {_string(table.caption)})"
    small = f"text(size: 8.5pt, fill: luma(35%), {_string(table.how)})"
    caption = f"#block(above: 12pt, below: 4pt, sticky: true, {bold})\n" if table.caption else ""
    how = f"\n#block(above: 5pt, below: 12pt, {small})" if table.how else ""
    return f"{caption}#table(columns: {len(table.header)}, align: ({align},), {fill}table.header({header}), {cells}){how}"


def _string(text: object) -> str:
    """A typst string literal."""
    inside = json.dumps(str(text), ensure_ascii=False)[1:-1]
    return '"' + "".join(c if c >= " " else " " for c in inside.replace("\\/", "/").replace("\\b", " ").replace("\\f",
                                                                                                                " ")) + '"'
