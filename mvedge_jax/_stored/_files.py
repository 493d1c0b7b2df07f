"""Files of programs: written as a whole, read only where nobody else can have written them."""

import contextlib
import hashlib
import hmac
import os
import secrets
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import jax

_MAGIC = b"mvedge_jax program 1\n"
_SUFFIX = ".program"
_UNFINISHED = ".unfinished"
# Seconds after which an unfinished file belongs to no living writer.
_ABANDONED = 3600.0


@dataclass(frozen=True)
class ProgramFiles:
    """A folder of programs by key.

    A program is read by `pickle`, which can run any code. So a file counts only if the user's own
    account wrote it and no other account could have: it is a regular file of this account with mode
    0600, in a folder of this account with mode 0700, neither of them a symbolic link. Its checksum
    and key are compared before anything is unpickled. A file that fails is ignored, and the program
    is compiled as usual.

    Attributes:
        folder: made with mode 0700 when the first program is written.
        limit: bytes of all programs; the ones unused for longest are dropped beyond it.
    """

    folder: Path
    limit: int = 1 << 30

    def read(self, key: str) -> bytes | None:
        """The bytes kept for a key, or None if there are none that can be trusted."""
        with contextlib.suppress(OSError), _opened(self.folder) as place:
            name = key + _SUFFIX
            file = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=place)
            with os.fdopen(file, "rb") as stream:
                about = os.fstat(file)
                if not (stat.S_ISREG(about.st_mode) and _is_private(about, 0o600)):
                    return None
                if about.st_size > self.limit:
                    return None
                data = _unsealed(stream.read(), key)
                if data is not None:
                    os.utime(file)  # used last now
                return data
        return None

    def write(self, key: str, data: bytes) -> bool:
        """Keeps bytes under a key; a reader meets all of them or none.

        Args:
            key: of letters and digits.
            data: any.

        Returns:
            Whether they are kept; they are not where the folder is another account's, open to
            others or full.
        """
        sealed = _sealed(data, key)
        if len(sealed) > self.limit:
            return False
        with contextlib.suppress(OSError):
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with _opened(self.folder) as place:
                unfinished = f"{key}.{secrets.token_hex(8)}{_UNFINISHED}"
                how = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
                file = os.open(unfinished, how, 0o600, dir_fd=place)
                try:
                    with os.fdopen(file, "wb") as stream:
                        stream.write(sealed)
                    os.replace(unfinished, key + _SUFFIX, src_dir_fd=place, dst_dir_fd=place)
                except BaseException:
                    with contextlib.suppress(OSError):
                        os.unlink(unfinished, dir_fd=place)
                    raise
                self._drop_oldest(place)
                return True
        return False

    def drop(self, key: str) -> None:
        """Removes a program that turned out to be of no use."""
        with contextlib.suppress(OSError), _opened(self.folder) as place:
            os.unlink(key + _SUFFIX, dir_fd=place)

    def _drop_oldest(self, place: int) -> None:
        """Brings the folder below its limit."""
        kept: list[tuple[float, str, int]] = []
        for name in os.listdir(place):
            with contextlib.suppress(OSError):
                about = os.stat(name, dir_fd=place, follow_symlinks=False)
                if name.endswith(_UNFINISHED) and time.time() - about.st_mtime > _ABANDONED:
                    os.unlink(name, dir_fd=place)
                elif name.endswith(_SUFFIX):
                    kept.append((about.st_mtime, name, about.st_size))
        total = sum(size for *_, size in kept)
        for _, name, size in sorted(kept):
            if total <= self.limit:
                break
            with contextlib.suppress(OSError):
                os.unlink(name, dir_fd=place)
            total -= size


@contextlib.contextmanager
def _opened(folder: Path) -> Iterator[int]:
    """The folder by its descriptor, so that nobody can put another in its place meanwhile.

    Raises:
        OSError: it isn't there, is a symbolic link, or isn't the account's alone.
    """
    place = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        if not _is_private(os.fstat(place), 0o700):
            raise PermissionError(f"{folder} is not the account's alone.")
        yield place
    finally:
        os.close(place)


def _is_private(about: os.stat_result, mode: int) -> bool:
    return about.st_uid == os.geteuid() and stat.S_IMODE(about.st_mode) == mode


def _sealed(data: bytes, key: str) -> bytes:
    return _MAGIC + _checksum(data, key) + data


def _unsealed(sealed: bytes, key: str) -> bytes | None:
    start = len(_MAGIC) + hashlib.blake2b().digest_size
    head, data = sealed[:start], sealed[start:]
    right = hmac.compare_digest(head, _MAGIC + _checksum(data, key))
    return data if right else None


def _checksum(data: bytes, key: str) -> bytes:
    checksum = hashlib.blake2b(key.encode())
    checksum.update(data)
    return checksum.digest()


# Set by `compilation_cache`, for the process, as JAX's own settings are.
_in_use: list[ProgramFiles] = []


def use(files: ProgramFiles) -> None:
    """Has programs kept in a folder, as long as JAX's cache stays in the folder around it."""
    if hasattr(os, "geteuid") and os.open in os.supports_dir_fd:
        _in_use[:] = [files]


def in_use() -> ProgramFiles | None:
    """Where programs are kept, or None while JAX's cache is off or elsewhere."""
    if not _in_use:
        return None
    configured = jax.config.values.get("jax_compilation_cache_dir")
    on = bool(jax.config.values.get("jax_enable_compilation_cache"))
    return _in_use[0] if on and configured == str(_in_use[0].folder.parent) else None
