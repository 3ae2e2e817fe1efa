"""Installs the Python module; called by catkin only (never by hand)."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(**generate_distutils_setup(packages=["robot_runner_ros1"], package_dir={"": "src"}))
