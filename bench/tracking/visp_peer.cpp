// Copyright 2026 selfcal_ros contributors
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

// ViSP's generic model-based tracker on a list of images, for bench/visp_peer.py.
//
// visp_peer MODEL.cao CONFIG.xml edges|both TX TY TZ RX RY RZ < IMAGE FILES
//
// One line an image: ok tx ty tz rx ry rz milliseconds. The time is that of track() alone. After a
// failure (an exception of the tracker) ok is 0 and the pose that of before.

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>

#include <visp3/core/vpImage.h>
#include <visp3/core/vpThetaUVector.h>
#include <visp3/io/vpImageIo.h>
#include <visp3/mbt/vpMbGenericTracker.h>

int main(int argc, char **argv) {
  if (argc != 10) {
    std::fprintf(stderr, "usage: %s MODEL CONFIG edges|both TX TY TZ RX RY RZ < FILES\n", argv[0]);
    return 2;
  }
  double pose[6];
  for (int i = 0; i < 6; i++) pose[i] = std::atof(argv[4 + i]);
  vpHomogeneousMatrix start(pose[0], pose[1], pose[2], pose[3], pose[4], pose[5]);
  try {
    vpMbGenericTracker tracker;
    int types = vpMbGenericTracker::EDGE_TRACKER;
    if (std::string(argv[3]) == "both") types |= vpMbGenericTracker::KLT_TRACKER;
    tracker.setTrackerType(types);
    std::cout.setstate(std::ios_base::failbit);
    tracker.loadConfigFile(argv[2]);
    tracker.loadModel(argv[1]);
    std::cout.clear();
    vpImage<unsigned char> image;
    std::string file;
    vpHomogeneousMatrix cMo = start;
    bool first = true;
    while (std::getline(std::cin, file)) {
      vpImageIo::read(image, file);
      if (first) {
        tracker.initFromPose(image, start);
        first = false;
      }
      int ok = 1;
      auto began = std::chrono::steady_clock::now();
      try {
        tracker.track(image);
        tracker.getPose(cMo);
      } catch (const vpException &) {
        ok = 0;
      }
      std::chrono::duration<double, std::milli> time = std::chrono::steady_clock::now() - began;
      vpTranslationVector t(cMo);
      vpThetaUVector r(cMo);
      std::printf("%d %.9g %.9g %.9g %.9g %.9g %.9g %.4f\n", ok, t[0], t[1], t[2], r[0], r[1],
                  r[2], time.count());
    }
  } catch (const vpException &error) {
    std::fprintf(stderr, "ViSP: %s\n", error.what());
    return 1;
  }
  return 0;
}
