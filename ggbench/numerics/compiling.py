"""Disk cache of compiled functions, identified by their source and written by one process.

The cache has two properties that numba's own cache lacks:

- Code is identified by the source of its module and of all imports of this module (:mod:`.cache`).
- One process compiles a function, while other processes wait and then load the code. With
  simultaneous writes, numba's index of a function could lose an entry, or return code for other
  argument types.

Each compiled function contains a copy of the functions that it calls. Results are nevertheless
bitwise equal in every process. Without ``fastmath`` the compiler must not change the rounding of a
copy.
"""

from __future__ import annotations

import contextlib
import gc
import pickle
from collections.abc import Iterator
from functools import cached_property, update_wrapper
from pathlib import Path
from typing import Any

from numba.core import caching, config, sigutils, types
from numba.core.compiler_lock import global_compiler_lock

from .cache import code_folder, exclusive_lock, make_code_folder


class Kernel:
    """Compiled function with code for calls by kernels, and separate code for calls by Python.

    Code of functions without a file (notebooks, ``exec``) is not stored on disk.

    The code for Python has an additional entry point, which unpacks the arguments. This code is
    compiled only at the first call from Python. The entry points of all functions would be a sixth
    of the compiled code.
    """

    def __init__(self, function: Any, jit: Any) -> None:
        """Prepare a function; ``jit`` is called with numba's options and returns a decorator."""
        update_wrapper(self, function)
        self.py_func, self._jit = function, jit
        file = Path(function.__code__.co_filename).resolve()
        self._has_file = file.is_file()  # not in a notebook, nor by exec
        if self._has_file:
            # Named by the source as it is imported, not as it is when code is first needed.
            code_folder(file)

    @cached_property
    def _entry(self) -> Any:
        return _compiled_once(self._jit()(self.py_func), self._cache(Locator))

    @cached_property
    def _part(self) -> Any:
        function = self._jit(no_cpython_wrapper=True)(self.py_func)
        return _compiled_once(function, self._cache(PartLocator))

    def _cache(self, locator: type[Locator]) -> _DiskCache | None:
        return _DiskCache(self.py_func, locator) if self._has_file else None

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call the compiled function and return its result."""
        return self._entry(*arguments, **named)

    @property
    def targetoptions(self) -> Any:
        """Options of the compilation; numba reads them from this attribute."""
        return self._part.targetoptions

    @property
    def signatures(self) -> list[Any]:
        """Argument types for which this process has code."""
        return [*self._entry.signatures, *self._part.signatures]

    @property
    def _numba_type_(self) -> Any:
        """Numba type of the kernel, under the name that numba expects."""
        return types.Dispatcher(self._part)


def _compiled_once(dispatcher: Any, cache: _DiskCache | None) -> Any:
    """Return a jitted function that is compiled by one process at a time and stored on disk.

    Without a ``cache`` the code is not stored on disk.
    """
    compile_now = dispatcher.compile

    def compile_once(signature: Any) -> Any:
        arguments, _ = sigutils.normalize_signature(signature)
        # A constant gets no code of its own: that was a sixth of all there is to compile.
        signature = tuple(types.unliteral(argument) for argument in arguments)
        if signature in dispatcher.overloads:
            return compile_now(signature)
        # The compiler's own lock first: threads and processes then wait in one order.
        locked = contextlib.nullcontext() if cache is None else cache.locked()
        with global_compiler_lock, locked, _without_collections():
            return compile_now(signature)

    dispatcher.compile = compile_once
    if cache is not None:
        dispatcher._cache = cache
    return dispatcher


@contextlib.contextmanager
def _without_collections() -> Iterator[None]:
    """Disable garbage collection: the millions of objects of the compiler remain in use."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


class Locator:
    """Locator that gives numba the cache folder of a function.

    The name of the folder contains a hash of the source.
    """

    SUFFIX = "entry"

    def __init__(self, py_func: Any, py_file: str) -> None:
        self._py_file = py_file  # numba's warnings name it
        self._line = py_func.__code__.co_firstlineno
        self._folder = code_folder(Path(py_file).resolve())

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Locator:
        """Return the locator of a Python function in a file."""
        return cls(py_func, py_file)

    def ensure_cache_path(self) -> None:
        """Create the cache folder. Raises OSError if this fails."""
        make_code_folder(self._folder)

    def get_cache_path(self) -> str:
        """Return the cache folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return the hash of the source, the stamp by which numba detects changes."""
        return self._folder.name

    def get_disambiguator(self) -> str:
        """Return a text that distinguishes functions of equal names in the folder."""
        return f"{self._line}.{self.SUFFIX}"


class PartLocator(Locator):
    """Locator of the code for calls by other kernels."""

    SUFFIX = "part"


class _DiskCache(caching.FunctionCache):
    """Code of one function on disk.

    If a file is damaged or the folder is read-only, the function is compiled again.
    """

    _held: set[Path] = set()
    """Locks of this process."""

    def __init__(self, function: Any, locator: type[Locator]) -> None:
        settings: Any = config  # numba reads its attributes from the environment
        chosen, settings.CACHE_LOCATOR_CLASSES = (
            settings.CACHE_LOCATOR_CLASSES,
            f"{__name__}.{locator.__name__}",
        )
        try:
            super().__init__(function)
        finally:
            settings.CACHE_LOCATOR_CLASSES = chosen
        line = function.__code__.co_firstlineno
        self._file = Path(self.cache_path) / f"{function.__qualname__}-{line}.{locator.SUFFIX}"

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write compiled code."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return compiled code, or None if it has to be compiled."""
        try:
            return super().load_overload(sig, target_context)
        except (OSError, EOFError, pickle.UnpicklingError):
            with contextlib.suppress(OSError):
                self.flush()
            return None

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from compiling this function."""
        if self._file in self._held:  # a function that needs itself, for other arguments
            yield
            return
        with contextlib.suppress(OSError):
            make_code_folder(self._file.parent)
        with exclusive_lock(self._file):
            self._held.add(self._file)
            try:
                yield
            finally:
                self._held.discard(self._file)
