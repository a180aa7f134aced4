"""How numba is made to give every process the same machine code.

Three things numba's own cache does not do:

- Code is found by the source of its module and of all that this imports (:mod:`.cache`).
- A function is compiled by one process at a time; the others wait, and load what it has written.
  Numba's index of a function would lose what two processes write at the same time, or serve one's
  code for the other's argument types.
- A library has the code of the functions it calls for itself. In numba it is a copy that the
  linker drops if another library of the process defines the same function, whose code has been
  optimised in another context and rounds otherwise. What a process had compiled or called before
  then decided the last digits of its results; a filter that diverges makes metres of them.
"""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from llvmlite.binding import Linkage
from numba.core import caching, sigutils, types
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler_lock import global_compiler_lock

from .cache import alone, code_folder, make_code_folder


def keep(dispatcher: Any) -> Any:
    """Have what a jitted function is compiled to kept on disk, and compiled by one process."""
    kept = _Cache(dispatcher.py_func)
    compile_now = dispatcher.compile

    def compile_alone(signature: Any) -> Any:
        arguments, _ = sigutils.normalize_signature(signature)
        # For a constant nothing is compiled of its own: it was a sixth of all there is to compile.
        signature = tuple(types.unliteral(argument) for argument in arguments)
        if signature in dispatcher.overloads:
            return compile_now(signature)
        # The compiler's own lock first: threads and processes then wait in one order.
        with global_compiler_lock, kept.alone():
            return compile_now(signature)

    dispatcher._cache = kept
    dispatcher.compile = compile_alone
    return dispatcher


class _Locator(caching._CacheLocator):
    """Where numba keeps what it compiles of a function: in the folder of its module's source."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        self._py_file = py_file
        self._line = py_func.__code__.co_firstlineno
        self.folder = code_folder(Path(py_file).resolve())

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> _Locator:
        return cls(py_func, py_file)

    def ensure_cache_path(self) -> None:
        make_code_folder(self.folder)

    def get_cache_path(self) -> str:
        return str(self.folder)

    def get_source_stamp(self) -> str:
        return self.folder.name

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Implementation(caching.CompileResultCacheImpl):
    _locator_classes = [_Locator]


class _Cache(caching.FunctionCache):
    """Compiled code of one function, on disk. A folder that cannot be written costs only time."""

    _impl_class = _Implementation
    _held: set[Path] = set()
    """Files locked by this process."""

    def _save_overload(self, signature: Any, result: Any) -> None:
        with contextlib.suppress(OSError):
            super()._save_overload(signature, result)

    def _load_overload(self, signature: Any, target_context: Any) -> Any:
        try:
            return super()._load_overload(signature, target_context)
        except (OSError, EOFError, pickle.UnpicklingError):
            # What a full disk or another hand has left is compiled anew.
            with contextlib.suppress(OSError):
                Path(self._cache_file._index_path).unlink()
            return None

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Keep other processes from compiling this function meanwhile."""
        file = self._impl.locator.folder / self._impl.filename_base
        if file in self._held:  # a function that needs itself, for other arguments
            yield
            return
        with contextlib.suppress(OSError):
            self._impl.locator.ensure_cache_path()
        with alone(file):
            self._held.add(file)
            try:
                yield
            finally:
                self._held.discard(file)


def _with_own_code(finalize: Any) -> Any:
    """Have a library use its own code of the functions it calls, wherever else they are defined."""

    def finalize_with_own_code(library: Any) -> None:
        module = library._final_module
        defined = [function for function in module.functions if not function.is_declaration]
        if defined:  # else it is loaded from the cache, and has been here before
            # Others link with the functions under their names (as in _get_module_for_linking).
            shared = module.clone()
            for function in defined:
                if function.linkage == Linkage.external:
                    shared.get_function(function.name).linkage = "linkonce_odr"
                elif function.linkage == Linkage.linkonce_odr:
                    function.linkage = "internal"
            library._shared_module = shared
        finalize(library)

    return finalize_with_own_code


_plain = CPUCodeLibrary._finalize_final_module
CPUCodeLibrary._finalize_final_module = _with_own_code(_plain)  # type: ignore[method-assign]
