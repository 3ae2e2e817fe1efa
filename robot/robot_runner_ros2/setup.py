"""Installs the package; called by colcon."""

from setuptools import setup

setup(
    name="robot_runner_ros2",
    version="0.2.0",
    packages=["robot_runner_ros2"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/robot_runner_ros2"]),
        ("share/robot_runner_ros2", ["package.xml"]),
        ("share/robot_runner_ros2/launch", ["launch/robot.launch.py"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The Robot Runner developers",
    maintainer_email="robot-runner@users.noreply.github.com",
    description="Robot Runner on a robot with ROS 2: the nodes of the tasks and of the watchdog.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "task_node = robot_runner_ros2.task_node:main",
            "watchdog_node = robot_runner_ros2.watchdog_node:main",
        ],
    },
)
