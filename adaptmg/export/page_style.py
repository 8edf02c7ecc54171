"""The style sheet of reports: readable tables, light or dark as the reader's system is."""

from __future__ import annotations

__all__ = ["STYLE"]

STYLE = """\
:root {
  color-scheme: light dark;
  --ink: #1f2328; --soft: #59636e; --line: #d7dce2; --paper: #ffffff; --band: #f5f7f9; --link: #0061a4;
}
@media (prefers-color-scheme: dark) {
  :root { --ink: #e3e7eb; --soft: #9aa4af; --line: #3a4149; --paper: #16191d; --band: #1e2227; --link: #6cb6f2; }
}
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.55 system-ui, sans-serif; }
main { max-width: min(96vw, 100rem); margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.9rem; line-height: 1.25; margin: 0 0 .6rem; }
h2 { font-size: 1.3rem; margin: 2.8rem 0 .6rem; padding-top: .6rem; border-top: 1px solid var(--line); }
p { max-width: 46rem; margin: .6rem 0; }
a { color: var(--link); text-decoration: none; }
a:hover { text-decoration: underline; }
nav { max-width: 44rem; background: var(--band); border-radius: 6px; padding: .7rem 1rem; margin: 1.4rem 0; }
nav ol { margin: 0; padding-left: 1.6rem; }
figure { margin: 1.5rem 0; }
figure img { max-width: min(100%, 62rem); height: auto; background: #ffffff; border-radius: 4px; }
figcaption { color: var(--soft); font-size: .92rem; max-width: 46rem; margin: .4rem 0; }
figure.table figcaption { color: var(--ink); font-weight: 600; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .82rem; font-variant-numeric: tabular-nums; }
thead th { border-bottom: 1.5px solid var(--ink); text-align: left; vertical-align: bottom; }
th, td { padding: .25rem .55rem; white-space: nowrap; }
th.n, td.n { text-align: right; }
tbody tr:nth-child(even) { background: var(--band); }
tbody tr:last-child td { border-bottom: 1px solid var(--line); }
.note { color: var(--soft); font-size: .88rem; }
footer { margin-top: 3.5rem; padding-top: .8rem; border-top: 1px solid var(--line); color: var(--soft);
  font-size: .85rem; }
"""
