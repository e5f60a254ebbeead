"""Libraries of toolboxes of MATLAB, by name: the product and its folder in an installation."""

import re

from kennfeld.base.lazy_dataclass import dataclass


@dataclass(frozen=True)
class Toolbox:
    """A product with libraries of blocks.

    Attributes:
        libraries: a pattern of their names.
        product: its name.
        folder: the folder below `matlabroot/toolbox` that contains them.
        physical: True if the blocks are elements of physical networks, whose equations are not in the model.
        hardware: True if the blocks read and drive the hardware of a target.
    """

    libraries: str
    product: str
    folder: str
    physical: bool = False
    hardware: bool = False


_SIMSCAPE = (
    "nesl_utility|fl_lib|ee_lib|elec_lib|sdl_lib|sm_lib|sh_lib|SimscapeFluids_lib|batt_lib|batteryecm_lib|pe_lib"
    "|powerlib|powerlib_models|sps_lib|sps[A-Z]\\w*|mblibv1"
)
_HARDWARE = (
    r"arduino\w*lib|raspberrypi\w*lib|mbedblockslib|stm32\w*lib|c28\w*lib|beaglebone\w*|lego(?:ev3|nxt)lib|sldrtlib"
    r"|embdlinuxlib|frdm\w*lib"
)
_TOOLBOXES = (
    Toolbox(_SIMSCAPE, "Simscape", "physmod", physical=True),
    Toolbox(r"pe[A-Z]\w+", "Simscape Electrical", "physmod"),
    Toolbox(r"dsp\w+", "DSP System Toolbox", "dsp"),
    Toolbox(r"aerolib\w+|shared(?:3dof|6dof|transform)\w*", "Aerospace Blockset", "aeroblks"),
    Toolbox(r"autolib\w+", "Powertrain Blockset", "autoblks"),
    Toolbox(r"vehdynlib\w+", "Vehicle Dynamics Blockset", "vdynblks"),
    Toolbox(r"comm\w+\d", "Communications Toolbox", "comm"),
    Toolbox(r"cstblocks", "Control System Toolbox", "control"),
    Toolbox(r"fuzblock", "Fuzzy Logic Toolbox", "fuzzy"),
    Toolbox(r"hdlsllib", "HDL Coder", "hdlcoder"),
    Toolbox(r"mpclib|softmpc", "Model Predictive Control Toolbox", "mpc"),
    Toolbox(r"neural", "Deep Learning Toolbox", "nnet"),
    Toolbox(r"ros2?lib", "ROS Toolbox", "ros"),
    Toolbox(_HARDWARE, "hardware support", "", hardware=True),
    Toolbox(r"BatteryEstimators", "Simscape Battery", "physmod"),
    Toolbox(r"robotcorelib", "Robotics System Toolbox", "robotics"),
    Toolbox(r"uavalgslib", "UAV Toolbox", "uav"),
    Toolbox(r"vision[a-z]+", "Computer Vision Toolbox", "vision"),
    Toolbox(r"vrlib", "Simulink 3D Animation", "sl3d"),
)


def toolbox_of(library: str) -> Toolbox | None:
    """Return the toolbox that contains a library; None for a library of the user.

    >>> toolbox_of("dspstat3").product, toolbox_of("engine_lib")
    ('DSP System Toolbox', None)
    """
    return next((toolbox for toolbox in _TOOLBOXES if re.fullmatch(toolbox.libraries, library)), None)
