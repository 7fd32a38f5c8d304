# SPDX-License-Identifier: Apache-2.0
"""A bar that shows how far a solve is."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType

from tqdm.auto import tqdm

from clba._summary import Iteration


class Progress:
    """A bar of tqdm, in a notebook one of its own kind."""

    def __init__(self, max_num_iterations: int) -> None:
        self._bar = tqdm(total=max_num_iterations, desc="clba", unit="iteration")

    def before(
        self, callback: Callable[[Iteration], bool | None] | None
    ) -> Callable[[Iteration], bool | None]:
        """A callback that moves the bar and then calls another."""

        def on_iteration(iteration: Iteration) -> bool | None:
            self._bar.set_postfix(cost=f"{iteration.cost:.6e}", refresh=False)
            self._bar.update(iteration.iteration - self._bar.n)
            self._bar.refresh()
            return None if callback is None else callback(iteration)

        return on_iteration

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._bar.close()
