"""Vector environment: several `GraspEnv` in one process, stepped in threads.

Kernels release Python's lock, so threads run kernels and Python code of different environments in
parallel. The result of an environment depends on its own seed alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import gymnasium
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from mjtactile.core import platform_support
from mjtactile.core.not_copyable import NotCopyable
from mjtactile.core.signature_checks import not_below, validated
from mjtactile.core.types import Array
from mjtactile.gym.env import GraspEnv


def make_vector(num_envs: int, device: str | None = None, **how: Any) -> gymnasium.vector.VectorEnv:
    """Create the vector environment: in threads, or with a `device` in MuJoCo Warp."""
    if device is None:
        return ThreadedVectorEnv(num_envs, **how)
    from mjtactile.gym.device_vector import DeviceVectorEnv  # of the extra `warp`

    return DeviceVectorEnv(num_envs, device, **how)


@validated(num_envs=not_below(1), threads=not_below(1))
class ThreadedVectorEnv(NotCopyable, SyncVectorEnv):
    """`num_envs` of `GraspEnv` with the other arguments `how`. Seeds are s, s + 1, ….

    `threads` step them (None: one for each processor). `autoreset_mode` is that of Gymnasium.
    """

    def __init__(
        self,
        num_envs: int,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **how: Any,
    ):
        self._threads = min(threads or platform_support.processors(), num_envs)
        self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="environments")
        super().__init__(
            [lambda: _Ahead(GraspEnv(**how))] * num_envs, autoreset_mode=autoreset_mode
        )

    @property
    def _ahead(self) -> list[Any]:
        return list(self.envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start the episodes of `seed`, seed + 1, … (None: the next), or of a list."""
        seeds = [seed + k for k in range(self.num_envs)] if isinstance(seed, int) else seed
        chosen = [None] * self.num_envs if seeds is None else seeds
        mask = (options or {}).get("reset_mask", [True] * self.num_envs)
        self._together(
            partial(env.reset_ahead, seed=one)
            for env, one, requested in zip(self._ahead, chosen, mask, strict=True)
            if requested
        )
        return super().reset(seed=seed, options=options)

    def step(self, actions: Array) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
        """Step each environment, or start the next episode where one is over."""
        own = list(gymnasium.vector.utils.iterate(self.action_space, actions))
        resets = self.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        self._together(
            env.reset_ahead if over and resets else partial(env.step_ahead, action)
            for env, action, over in zip(self._ahead, own, self._autoreset_envs, strict=True)
        )
        return super().step(actions)

    def _together(self, jobs: Iterable[Callable[[], None]]) -> None:
        """Run all jobs, distributed over the threads, and raise the first error of any job."""
        every = list(jobs)
        groups, *others = (every[k :: self._threads] for k in range(self._threads))
        futures = [self._pool.submit(_run_all, part) for part in others]
        _run_all(groups)
        for future in futures:
            future.result()

    def close_extras(self, **kwargs: Any) -> None:
        """Close all simulations and stop the threads."""
        super().close_extras(**kwargs)
        self._pool.shutdown()


def _run_all(jobs: Iterable[Callable[[], None]]) -> None:
    for job in jobs:
        job()


class _Ahead(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Wrapper that returns a step or reset computed earlier in a thread."""

    def __init__(self, env: GraspEnv):
        super().__init__(env)
        self._done: Any = None

    def reset_ahead(self, seed: int | None = None) -> None:
        self._done = self.env.reset(seed=seed)

    def step_ahead(self, action: Array) -> None:
        self._done = self.env.step(action)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return self._take() or self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> Any:
        return self._take() or self.env.step(action)

    def _take(self) -> Any:
        done = self._done
        self._done = None
        return done
