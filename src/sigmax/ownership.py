"""Who could have written a file: what others can change is not executed."""

import contextlib
import os
import stat
from pathlib import Path


def stranger(path: Path, root: Path | None = None) -> str:
    """Why somebody else could have written what lies at a path, in words; empty where only the user and root can.

    The file or folder and every folder above it count, as a folder lets its owner exchange what is in it. One above
    with the sticky bit, such as /tmp, lets others add files but not exchange ours. A group in which the user is
    alone counts as the user. Links are followed. On systems without owners of files the answer is empty.

    Args:
        path: of the file or folder; where there is none, those above it count.
        root: a folder above that is the user's alone, its path without links: the question ends there, and neither a
            group, nor a sticky bit, nor a link excuses anything.
    """
    if not hasattr(os, "geteuid"):
        return ""
    real = path.resolve()
    if root is not None and real != path:
        return f"{path} is a link, or lies behind one"
    for place in (real, *real.parents):
        with contextlib.suppress(FileNotFoundError):
            if said := _stranger(place, place.stat(), place != real, root is not None):
                return said
        if place == root:
            break
    return ""


def _stranger(place: Path, known: os.stat_result, above: bool, strict: bool) -> str:
    if known.st_uid not in (0, os.geteuid()):
        return f"{place} belongs to another user ({_user(known.st_uid)})"
    sticky = above and not strict and known.st_mode & stat.S_ISVTX
    if known.st_mode & stat.S_IWOTH and not sticky:
        return f"{place} can be written by every user"
    trusted = not strict and (known.st_gid == 0 or _alone_in(known.st_gid))
    if known.st_mode & stat.S_IWGRP and not sticky and not trusted:
        return f"{place} can be written by the group {_group(known.st_gid)}"
    return ""


def _alone_in(gid: int) -> bool:
    """Whether a group is the user's own, as many systems make one for each user."""
    import grp
    import pwd

    try:
        user, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(gid)
    except KeyError:
        return False
    return group.gr_gid == user.pw_gid and group.gr_name == user.pw_name and set(group.gr_mem) <= {user.pw_name}


def _user(uid: int) -> str:
    import pwd

    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"number {uid}"


def _group(gid: int) -> str:
    import grp

    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return f"number {gid}"
