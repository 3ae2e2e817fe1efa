"""Installs the package; catkin and colcon both call this."""

from setuptools import setup

setup(
    name="robot_runner_onboard",
    version="0.2.0",
    packages=["robot_runner_onboard"],
    package_dir={"": "src"},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/robot_runner_onboard"]),
        ("share/robot_runner_onboard", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    maintainer="The Robot Runner developers",
    maintainer_email="robot-runner@users.noreply.github.com",
    description="Robot Runner on a robot, without ROS: the tasks of a mission, and the watchdog.",
    license="Apache-2.0",
)
