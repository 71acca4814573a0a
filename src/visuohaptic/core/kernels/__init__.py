"""Compiled functions: decorator, compilation with numba, and a cache of machine code that is never stale."""

from .cache import KERNELS, SHIPPED_CPU, KernelCache, cache_folder, kernel, remove_stale, shipped_name
from .code import code_digest, kernel_name, text_digest
from .compiler import compiled_s

__all__ = [
    "KERNELS", "SHIPPED_CPU", "KernelCache", "cache_folder", "code_digest", "compiled_s", "kernel", "kernel_name",
    "remove_stale", "shipped_name", "text_digest",
]  # fmt: skip
