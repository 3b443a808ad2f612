"""Export policies to ONNX, TorchScript and torch.export files."""
