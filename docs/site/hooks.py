"""Tutorials are executable scripts in cells (``# %%``); the site shows each as a page of its comments and its code."""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.structure.files import File


def page_of(script: str) -> str:
    """Markdown of a script in cells: the docstring is the introduction, ``# %%`` heads a section, its comments are the text."""
    docstring, _, body = script.partition('"""')[2].partition('"""')
    lines, code = [docstring.strip(), ""], []

    def flush() -> None:
        text = "\n".join(code).strip()
        if text:
            lines.extend(["```python", text, "```", ""])
        code.clear()

    told = False
    for line in body.splitlines():
        head = re.match(r"# %% (.*)", line)
        if head:
            flush()
            lines.extend(["## " + head.group(1).rstrip("- "), ""])
            told = True
        elif told and line.startswith("# "):
            lines.append(line[2:])
        else:
            if told and line.strip():
                lines.append("")
                told = False
            code.append(line)
    flush()
    return "\n".join(lines) + "\n"


def on_files(files, config):
    """Add a page for every tutorial."""
    root = Path(config.docs_dir)
    for script in sorted((root / "docs" / "tutorials").glob("*.py")):
        name = f"docs/tutorials/{script.stem}.md"
        files.append(File.generated(config, name, content=page_of(script.read_text(encoding="utf-8"))))
    return files
