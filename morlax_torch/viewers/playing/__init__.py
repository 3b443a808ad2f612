"""Run exported policies in C MuJoCo, without torch and the simulator of their training."""
