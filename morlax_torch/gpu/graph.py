"""Record a function's GPU work once as a CUDA graph, then replay it without Python."""

import gc
from collections.abc import Callable, Iterable

import torch

from ..host.phases import phase


class Branch:
    """GPU work that runs in parallel with later work until `join`; on the CPU it runs at once.

    Inside a recording it becomes a branch of the graph. Tensors that it reads must stay alive and
    unchanged until the `join`.
    """

    def __init__(self, device: torch.device):
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None

    def __enter__(self) -> None:
        if self._stream is not None:
            self._stream.wait_stream(torch.cuda.current_stream(self._stream.device))
            self._within = torch.cuda.stream(self._stream)
            self._within.__enter__()

    def __exit__(self, *error: object) -> None:
        if self._stream is not None:
            self._within.__exit__(*error)

    def join(self) -> None:
        """Make later work wait for this branch."""
        if self._stream is not None:
            torch.cuda.current_stream(self._stream.device).wait_stream(self._stream)


class Graph:
    """A function that, once recorded on CUDA, replays as one graph per call.

    `run` takes and returns nothing. It reads and writes tensors that outlive it, in place, and
    never reads a GPU value on the CPU: no `.item()`, no boolean indexing, no shape that depends on
    data. Torch and Warp work are recorded alike. On the CPU each call simply calls `run`.

    It draws from the `generators`. `warm_up` is a shorter `run` that launches the same kernels.
    """

    def __init__(
        self,
        run: Callable[[], None],
        device: torch.device,
        generators: Iterable[torch.Generator] = (),
        warm_up: Callable[[], None] | None = None,
    ):
        self.run, self.device, self.generators = run, device, list(generators)
        self._warm_up = warm_up or run
        self._graph: torch.cuda.CUDAGraph | None = None

    def __call__(self) -> None:
        if self._graph is None:
            with self._full_precision():
                self.run()
        else:
            self._graph.replay()

    def _full_precision(self) -> torch.autocast:
        return torch.autocast(self.device.type, enabled=False)  # that a user may have enabled

    def record(self) -> None:
        """Warm up once, then record. The effects of `warm_up` remain; on the CPU, do nothing."""
        if self.device.type != "cuda":
            return
        import warp as wp

        phase("compiling kernels")
        wp.init()
        current = torch.cuda.current_device()
        stream = torch.cuda.Stream(self.device)
        warp_stream = wp.stream_from_torch(stream)  # Warp knows the capture by this one object
        graph = torch.cuda.CUDAGraph()
        for generator in self.generators:
            graph.register_generator_state(generator)
        torch.cuda.synchronize(self.device)
        scope = wp.ScopedStream(warp_stream, sync_enter=False)
        with self._full_precision(), torch.cuda.device(self.device), scope:
            with torch.cuda.stream(stream):
                self._warm_up()  # kernels compile and load, and cuBLAS initializes
            torch.cuda.synchronize(self.device)
            collecting = gc.isenabled()
            gc.disable()  # a finalizer that frees GPU memory would break the recording
            try:
                with torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local"):
                    wp.capture_begin(stream=warp_stream, external=True)
                    self.run()
                    self._kernels = wp.capture_end(stream=warp_stream)  # keeps them loaded
            finally:
                if collecting:
                    gc.enable()
        torch.cuda.synchronize(self.device)
        torch.cuda.set_device(current)  # Warp leaves its own device current
        self._graph = graph
