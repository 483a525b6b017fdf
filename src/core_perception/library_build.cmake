# SPDX-License-Identifier: BSD-3-Clause
# Sources and flags of the two libraries, for the package and for bench/, which builds them by itself.
file(GLOB core_semantic_octree_SOURCES CONFIGURE_DEPENDS ${CMAKE_CURRENT_LIST_DIR}/src/semantic_octree*.cpp)
# Whatever lies directly in src/ is free of ROS.
file(GLOB core_perception_SOURCES CONFIGURE_DEPENDS ${CMAKE_CURRENT_LIST_DIR}/src/*.cpp)
list(REMOVE_ITEM core_perception_SOURCES ${core_semantic_octree_SOURCES})

# Loops become vector instructions only where comparisons may not trap; without fused multiplication every processor
# computes the same bits.
set(CMAKE_CXX_FLAGS_RELEASE "-O3 -DNDEBUG -ffp-contract=off -fno-math-errno -fno-trapping-math")

# What every x86-64 since 2009 has, or all that the processor at hand has. Nothing in the headers depends on it.
option(CORE_NATIVE "build core_perception for the processor at hand" OFF)
include(CheckCXXCompilerFlag)
if(CORE_NATIVE)
  add_compile_options(-march=native)
elseif(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  check_cxx_compiler_flag(-march=x86-64-v2 KNOWS_LEVELS)
  if(KNOWS_LEVELS)
    add_compile_options(-march=x86-64-v2)
  else()  # compilers before GCC 11
    add_compile_options(-mcx16 -msahf -mpopcnt -msse4.2)
  endif()
endif()
