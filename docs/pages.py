"""Blocks of the pages, and the pictures that their code draws.

A page that shows `![…](NAME.svg)` draws it in its Python blocks: `figure.savefig("NAME.svg")`. Tests run every page
and leave the pictures under `build/pictures`; where they are not there, or are of another text, the site runs the
page itself.
"""

import hashlib
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parent.parent
_FENCE = re.compile(r"^(?P<indent> *)```(?P<info>[^\n`]*)\n(?P<body>.*?)^(?P=indent)```$", re.MULTILINE | re.DOTALL)
_TITLE = re.compile(r'title="([^"]*)"')
_FILE = re.compile(r"[\w-]+\.(toml|csv|py|json|c)")
_PICTURE = re.compile(r"!\[[^\]]*\]\(([\w-]+\.svg)\)")


class Block(NamedTuple):
    """A fenced block: where it stands, its language, its title, its lines."""

    line: int
    language: str
    title: str
    body: str

    @property
    def is_file(self) -> bool:
        """Whether it is written to the file of its title."""
        return _FILE.fullmatch(self.title) is not None


def blocks_of(page: Path) -> list[Block]:
    """The fenced blocks of a page, in their order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in _FENCE.finditer(text):
        indent, info = match["indent"], match["info"].strip()
        title = _TITLE.search(info)
        body = "".join(line.removeprefix(indent) for line in match["body"].splitlines(keepends=True))
        start = text.count("\n", 0, match.start()) + 1
        found.append(Block(start, info.split()[0] if info else "", title[1] if title else "", body))
    return found


def pictures_of(page: Path) -> list[str]:
    """The pictures that a page draws."""
    return _PICTURE.findall(page.read_text(encoding="utf-8"))


def gallery(page: Path) -> Path:
    """Where the pictures of a page with this text are kept."""
    return ROOT / "build" / "pictures" / f"{page.stem}-{hashlib.sha256(page.read_bytes()).hexdigest()[:16]}"


def on_files(files: Any, config: Any) -> Any:
    """Give the site the pictures of its pages."""
    from mkdocs.structure.files import File

    for page in sorted((ROOT / "docs").rglob("*.md")):
        folder = gallery(page)
        missing = [name for name in pictures_of(page) if not (folder / name).exists()]
        if missing:
            folder.mkdir(parents=True, exist_ok=True)
            blocks = blocks_of(page)
            for block in blocks:
                if block.is_file:
                    (folder / block.title).write_text(block.body, encoding="utf-8")
            code = "\n".join(block.body for block in blocks if block.language == "python" and not block.is_file)
            subprocess.run([sys.executable, "-c", code], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        for name in pictures_of(page):
            place = (page.parent / name).relative_to(ROOT / "docs").as_posix()
            files.append(File.generated(config, place, abs_src_path=str(folder / name)))
    return files
