"""What is wrong with a description, in words."""

from pydantic import ValidationError


def in_words(error: ValidationError) -> str:
    """The first thing that is wrong; the others often follow from it."""
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    if first["type"] == "missing":
        *above, key = (str(part) for part in first["loc"])
        where = f"[{'.'.join(above)}]" if above else "the top of the file, before the first [table],"
        return f"{where} needs the key {key!r}"
    if first["type"] in ("table", "key", "empty"):
        return f"{f'{place}: ' if place else ''}{first['msg']}"
    wanted = _WANTED.get(first["type"], first["msg"][:1].lower() + first["msg"][1:])
    return f"{place}: {wanted}; it is {first['input']!r}"


_WANTED = {
    "string_type": "this must be text in quotes",
    "list_type": "this must be a list in brackets",
    "dict_type": "this must be a table of keys",
    "bool_type": "this must be true or false",
    "too_short": "this must not be empty",
}
