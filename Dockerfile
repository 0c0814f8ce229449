# selfcal_ros on ROS 2 Jazzy: docker build -t selfcal_ros . && docker run --rm --net host selfcal_ros selfcal demo
# Another distribution: docker build --build-arg ROS_DISTRO=kilted -t selfcal_ros .
ARG ROS_DISTRO=jazzy
FROM ros:${ROS_DISTRO}-ros-base

# what package.xml names; a layer of its own, which changes of the sources leave alone
WORKDIR /ws
COPY package.xml src/selfcal_ros/package.xml
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3-pip \
    && rosdep update \
    # rosbags comes from the Python package index; nobody looks at RViz in a container
    && PIP_BREAK_SYSTEM_PACKAGES=1 rosdep install --yes --from-paths src --ignore-src --skip-keys rviz2 \
    && rm -rf /var/lib/apt/lists/*

COPY README.md LICENSE pyproject.toml setup.cfg setup.py src/selfcal_ros/
COPY resource src/selfcal_ros/resource
COPY config src/selfcal_ros/config
COPY launch src/selfcal_ros/launch
COPY scripts src/selfcal_ros/scripts
COPY bags src/selfcal_ros/bags
COPY docs/result.schema.json docs/selfcal.1 src/selfcal_ros/docs/
COPY msg_adapters src/selfcal_ros/msg_adapters
COPY selfcal_ros src/selfcal_ros/selfcal_ros
RUN . /opt/ros/${ROS_DISTRO}/setup.sh && colcon build

# the entry point of the base image sources ROS alone
RUN printf '#!/bin/bash\nsource /ws/install/setup.bash\nexec "$@"\n' > /entry.sh && chmod +x /entry.sh
ENV PATH=/ws/install/selfcal_ros/lib/selfcal_ros:${PATH}
ENTRYPOINT ["/ros_entrypoint.sh", "/entry.sh"]
CMD ["ros2", "launch", "selfcal_ros", "agv.launch.py", "image:=/camera/image_raw"]
