"""Record a function's GPU work once, then replay it without Python."""

import gc
from collections.abc import Callable, Iterable

import torch

WARMUPS = 2  # kernels compile and load, autograd and cuBLAS set themselves up


class Beside:
    """Work that may run beside what follows it, until `join`; on the CPU it runs before.

    Inside a recording it becomes a branch of the graph. Whatever it reads must stay alive, and
    unwritten, until the `join`.
    """

    def __init__(self, device: torch.device):
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None

    def __enter__(self) -> None:
        if self._stream is not None:
            self._stream.wait_stream(torch.cuda.current_stream())
            self._within = torch.cuda.stream(self._stream)
            self._within.__enter__()

    def __exit__(self, *error: object) -> None:
        if self._stream is not None:
            self._within.__exit__(*error)

    def join(self) -> None:
        """Let what follows wait for it."""
        if self._stream is not None:
            torch.cuda.current_stream().wait_stream(self._stream)


class Graph:
    """Call it as you would call `run`; on CUDA, once recorded, a call replays one graph.

    `run` takes and returns nothing. It reads and writes tensors that outlive it, in place, and
    never lets the CPU look at a value on the GPU: no `.item()`, no boolean indexing, no shape
    that depends on data. Torch and Warp work are recorded alike. On the CPU it is simply `run`.
    """

    def __init__(
        self,
        run: Callable[[], None],
        device: torch.device,
        generators: Iterable[torch.Generator] = (),
    ):
        self.run, self.device, self.generators = run, device, list(generators)
        self._graph: torch.cuda.CUDAGraph | None = None

    def __call__(self) -> None:
        if self._graph is None:
            self.run()
        else:
            self._graph.replay()

    def record(self) -> None:
        """Run twice and record the third; on the CPU, nothing. What `run` changes is changed."""
        if self.device.type != "cuda":
            return
        import warp as wp

        stream = torch.cuda.Stream(self.device)
        warp_stream = wp.stream_from_torch(stream)  # Warp knows the capture by this one object
        graph = torch.cuda.CUDAGraph()
        for generator in self.generators:
            graph.register_generator_state(generator)
        torch.cuda.synchronize(self.device)
        with wp.ScopedStream(warp_stream, sync_enter=False):
            with torch.cuda.stream(stream):
                for _ in range(WARMUPS):
                    self.run()
            torch.cuda.synchronize(self.device)
            gc.collect()
            gc.disable()  # a finaliser that frees GPU memory would break the recording
            try:
                with torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local"):
                    wp.capture_begin(stream=warp_stream, external=True)
                    self.run()
                    self._kernels = wp.capture_end(stream=warp_stream)  # keeps them loaded
            finally:
                gc.enable()
        torch.cuda.synchronize(self.device)
        self._graph = graph
