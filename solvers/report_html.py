"""A report as one HTML file: pictures inline, nothing fetched, prints well. Everything written is escaped."""

from __future__ import annotations

import base64
from typing import Any

from .legend import INKS
from .report_document import Document, Figure, Number, Table, Words

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{{ document.title }}</title>
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<style>
body { font: 14px/1.45 system-ui, sans-serif; color: #222; max-width: 60em; margin: 2em auto; padding: 0 1em }
h1 { font-size: 1.7em; font-weight: 600; margin: 0 0 .4em } h2 { font-size: 1.2em; border-bottom: 1px solid #ccc; margin: 2em 0
.6em }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .1em 1em; margin: 0 } dt { color: #666 } dd { margin: 0 }
table { border-collapse: collapse; font-size: 12.5px; margin: .4em 0; font-variant-numeric: tabular-nums }
caption { text-align: left; font-weight: 600; padding: .3em 0 } th { text-align: left; font-weight: 600; border-bottom: 1px
solid #888 }
th, td { padding: .15em .7em .15em 0; vertical-align: top } td.number, th.number { text-align: right; white-space: nowrap }
tr.marked td { background: #fff3e6 } thead { display: table-header-group } tr, figure { break-inside: avoid }
.how, figcaption { color: #666; font-size: 12px; margin: .2em 0 1em } figure { margin: 1em 0 } figure img { width: 100% }
figure.narrow img { width: 62% } .warning { border-left: 3px solid {{ inks.residual }}; padding: .2em .8em; margin: .4em 0;
background: #fff8f2 }
.statement { border-left: 3px solid {{ inks.perspective }}; padding: .3em .8em; margin: .6em 0 }
.note { color: #555; font-size: 12.5px }
.wide { overflow-x: auto } @page { size: A4; margin: 16mm } @media print { body { margin: 0; max-width: none; font-size: 10pt }
table { font-size: 7.6pt } h2 { break-after: avoid } .wide { overflow: visible } }
</style></head><body>
<h1>{{ document.title }}</h1>
<dl>{% for name, value in document.facts.items() %}<dt>{{ name }}</dt><dd>{{ value }}</dd>{% endfor %}</dl>
{% for section in document.sections %}<h2>{{ section.title }}</h2>
{% for part in section.parts %}{% if kind(part) == "words" %}<p class="{{ part.kind }}">{{ part.text }}</p>
{% elif kind(part) == "figure" %}<figure{% if not part.wide %} class="narrow"{% endif %}>
<img alt="{{ part.caption }}" src="data:image/svg+xml;base64,{{ encoded(part.svg) }}"><figcaption>{{ part.caption
}}</figcaption></figure>
{% else %}{% set right = part.right %}
<div class="wide"><table>{% if part.caption %}<caption>{{ part.caption }}</caption>{% endif %}
<thead><tr>{% for name in part.header %}<th{% if right[loop.index0] %} class="number"{% endif
%}>{{ name }}</th>{% endfor %}</tr></thead><tbody>
{% for row in part.rows %}<tr{% if loop.index0 in part.marked %} class="marked"{% endif %}>{% for cell in row %}{% set
class = ' class="number"' | safe if right[loop.index0] else "" %}{% if number(cell) -%}
<td{{ class }}{% if cell.key and cell.value is not none %} data-key="{{ cell.key }}" data-value="{{ full(cell) }}"{% endif
%}>{{ cell }}</td>
{%- else %}<td{{ class }}>{{ cell }}</td>{% endif %}{% endfor %}</tr>
{% endfor %}</tbody></table></div>{% if part.how %}<p class="how">{{ part.how }}</p>{% endif %}
{% endif %}{% endfor %}{% endfor %}</body></html>
"""


def html(document: Document) -> str:
    """The page. Numbers of the run carry their JSON pointer (data-key) and their full value (data-value)."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    environment.globals.update(kind=_kind, inks=INKS, encoded=_encoded, number=lambda cell: isinstance(cell, Number),
                               full=lambda n: repr(n.value))
    return environment.from_string(PAGE).render(document=document)


def _kind(part: Any) -> str:
    return {Words: "words", Figure: "figure", Table: "table"}[type(part)]


def _encoded(svg: str) -> str:
    return base64.b64encode(svg.encode()).decode()
