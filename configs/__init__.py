"""The default config of each task, as YAML."""

if __name__ == "configs":
    raise ImportError("import this package as morlax_torch.configs, not as configs.")
