"""The built-in tasks, by name, each as the module and the class that define it."""

MO_GYMNASIUM = {
    "mo-gymnasium/ant": "mo_gymnasium:Ant",
    "mo-gymnasium/ant-2obj": "mo_gymnasium:Ant2",
    "mo-gymnasium/halfcheetah": "mo_gymnasium:HalfCheetah",
    "mo-gymnasium/hopper": "mo_gymnasium:Hopper",
    "mo-gymnasium/hopper-2obj": "mo_gymnasium:Hopper2",
    "mo-gymnasium/humanoid": "mo_gymnasium:Humanoid",
    "mo-gymnasium/swimmer": "mo_gymnasium:Swimmer",
    "mo-gymnasium/walker2d": "mo_gymnasium:Walker2d",
}
PGMORL = {
    f"pgmorl/{member.lower()}": f"pgmorl:{member}"
    for member in ["Ant", "HalfCheetah", "Hopper", "Hopper3", "Humanoid", "Swimmer", "Walker2d"]
}
COLA = {
    "cola/ant-3d": "cola:Ant3",
    "cola/ant-4d": "cola:Ant4",
    "cola/ant-5d": "cola:Ant5",
    "cola/halfcheetah-5d": "cola:HalfCheetah5",
    "cola/hopper-5d": "cola:Hopper5",
}
TASKS = {
    "ant": "spatial:Ant",
    "bruce": "bruce.task:Bruce",
    "cheetah": "cheetah:Cheetah",
    "cheetah3": "cheetah:Cheetah3",
    "hopper": "planar:Hopper",
    "humanoid": "spatial:Humanoid",
    "walker": "planar:Walker",
    "design/ant": "designed:DesignedAnt",
    "design/cheetah": "designed:DesignedCheetah",
    "design/hopper": "designed:DesignedHopper",
    **PGMORL,
    **COLA,
    **MO_GYMNASIUM,
}
