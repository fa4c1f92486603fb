"""Functions from a user's own file, written "file.py:function"."""

import importlib.util
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from sigmax.errors import InputError, unknown


def is_reference(kind: Any) -> bool:
    """Whether a text means a function in a file."""
    return isinstance(kind, str) and ".py:" in kind


class Functions:
    """Functions of files beside a description; each file is executed once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._modules: dict[Path, ModuleType] = {}

    def __call__(self, reference: str, where: str) -> Callable[..., Any]:
        """The function that "file.py:function" means.

        Raises:
            InputError: where the file or the function does not exist, or the file fails.
        """
        file, _, name = reference.rpartition(":")
        module = self._module(self._folder / file, where)
        known = [n for n, value in vars(module).items() if callable(value) and not n.startswith("_")]
        function = getattr(module, name, None)
        if not callable(function):
            raise InputError(f"{where}: {unknown(f'function of {file}', name, known)}")
        found: Callable[..., Any] = function
        return found

    def _module(self, path: Path, where: str) -> ModuleType:
        if path in self._modules:
            return self._modules[path]
        if not path.is_file():
            raise InputError(f"{where}: there is no file {path}; paths are relative to the description")
        spec = importlib.util.spec_from_file_location(f"sigmax_user_{path.stem}", path)
        if spec is None or spec.loader is None:
            raise InputError(f"{where}: {path} is no Python file")
        module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except SyntaxError as error:
            raise InputError(f"{where}: {path.name}, line {error.lineno}: {error.msg}") from error
        except (Exception, SystemExit) as error:
            line = traceback.extract_tb(error.__traceback__)[-1].lineno
            raise InputError(f"{where}: {path.name} fails at line {line}: {type(error).__name__}: {error}") from error
        self._modules[path] = module
        return module
