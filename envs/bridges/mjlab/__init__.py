"""Bridge to mjlab, the library of robot tasks on MuJoCo Warp."""
