"""Write the catalogues of page and report: every text that they say, with the translations so far, and the compiled form.

`make texts` runs it. What is new stands in the .po file without a translation, for a person to translate; then run it again.
With `--check` nothing is written; the exit code is 1 where a text is missing or a catalogue would change.
"""

import importlib
import io
import pkgutil
import re
import sys
from pathlib import Path

from babel.messages.catalog import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po, write_po

import monitor
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.reason import OF_NO_LANGUAGE, SENTENCES

ROOT = Path(__file__).parents[2]
LOCALE = ROOT / "monitor" / "views" / "language" / "locale"
KEYWORDS = {"say": None, "t": None, "N_": None}


def in_brackets(fileobj, keywords, comment_tags, options):  # noqa: ARG001  # Babel calls it so
    """The texts of a page, which stand in double brackets; an extractor of Babel."""
    for number, line in enumerate(io.TextIOWrapper(fileobj, "utf-8"), start=1):
        for text in re.findall(r"\[\[(.+?)\]\]", line):
            yield number, None, text, []


def in_script(fileobj, keywords, comment_tags, options):  # noqa: ARG001  # Babel calls it so
    """The texts of a script: strings in the first argument of t() and N_(), also inside templates, which Babel leaves out."""
    source = fileobj.read().decode()
    for call in re.finditer(r"\b(?:t|N_)\(", source):
        for text in _strings_of_first_argument(source[call.end() :]):
            yield source.count("\n", 0, call.start()) + 1, None, text, []


def _strings_of_first_argument(source):
    depth = 0
    for token in re.finditer(r'"((?:[^"\\]|\\.)*)"|[()\[\]{},]', source):
        if token[1] is not None:
            if depth == 0:  # not in a call of another function
                yield token[1]
        elif token[0] in "([{":
            depth += 1
        elif depth == 0:
            return
        elif token[0] in ")]}":
            depth -= 1


METHODS = [("**/uPlot*", "ignore"), ("**.py", "python"), ("**.js", in_script), ("**.html", in_brackets)]
SAYING = ("monitor/views", "monitor/plant/screen", "monitor/gateway")  # folders whose texts people read


def template() -> Catalog:
    """Every text, without translations."""
    found = Catalog(project="joint-monitor", charset="utf-8")
    for folder in SAYING:
        for path, _, text, _, _ in extract_from_dir(ROOT / folder, METHODS, {}, keywords=KEYWORDS, comment_tags=()):
            if path.startswith("language/locale") or not isinstance(text, str) or not text.strip():
                continue
            found.add(text, locations=[(f"{folder}/{path}", None)])
    for condition in CONDITIONS.values():
        found.add(condition.name, locations=[("monitor/judge/alerts/conditions.py", None)])
    import_all()
    for code, text in SENTENCES.items():
        if code not in OF_NO_LANGUAGE:
            found.add(text, context=code)
    return found


def import_all() -> None:
    """Import every module, so that `SENTENCES` has the sentences of all of them."""
    for module in pkgutil.walk_packages(monitor.__path__, "monitor."):
        if not module.name.endswith("__main__") and ".migrations." not in module.name:
            importlib.import_module(module.name)


def read(code: str) -> Catalog:
    """The catalogue of a language as it is stored."""
    with (LOCALE / code / "LC_MESSAGES" / "joint_monitor.po").open("rb") as file:
        return read_po(file, locale=code)


def compiled(catalogue: Catalog) -> bytes:
    """The catalogue as gettext reads it."""
    made = io.BytesIO()
    write_mo(made, catalogue)
    return made.getvalue()


def main(argv: list[str]) -> int:
    """1 where a text has no translation yet or, with --check, where a catalogue would change."""
    check, wrong = argv == ["--check"], 0
    every_text = template()
    for folder in sorted(path for path in LOCALE.iterdir() if path.is_dir()):
        catalogue = read(folder.name)
        dated = catalogue.creation_date  # kept, so that the same texts make the same files
        catalogue.update(every_text, no_fuzzy_matching=True)
        catalogue.creation_date = dated
        catalogue.obsolete.clear()
        for message in catalogue:
            if message.id and not message.string:
                sys.stdout.write(f"{folder.name}: not translated: {f'{message.context}: ' if message.context else ''}{message.id}\n")
                wrong += 1
        written = io.BytesIO()
        write_po(written, catalogue, width=0, include_lineno=False, sort_output=True, omit_header=False)
        target = folder / "LC_MESSAGES" / "joint_monitor"
        for path, content in ((target.with_suffix(".po"), written.getvalue()), (target.with_suffix(".mo"), compiled(catalogue))):
            if check and path.read_bytes() != content:
                sys.stdout.write(f"{path.relative_to(ROOT)} is not what `make texts` writes\n")
                wrong += 1
            elif not check:
                path.write_bytes(content)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
