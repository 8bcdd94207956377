from glob import glob

from setuptools import find_packages, setup

NAME = "wsg_gripper_driver"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "README.md"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*.yaml")),
        (f"share/{NAME}/urdf", glob("urdf/*.xacro")),
    ],
    install_requires=["setuptools", "wsg-gripper"],
    python_requires=">=3.10",
    zip_safe=True,
    description="ROS 2 driver for Weiss Robotics WSG servo grippers",
    author="The wsg-bridge authors",
    author_email="authors@repository.invalid",
    project_urls={"Source Code": "https://repository.invalid/wsg-bridge"},
    license="MIT OR Apache-2.0",
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3 :: Only",
        "Topic :: Scientific/Engineering",
    ],
    entry_points={"console_scripts": [f"wsg_gripper = {NAME}.node:main"]},
)
