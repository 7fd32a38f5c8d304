# SPDX-License-Identifier: Apache-2.0
# What an installed copy holds: headers, library, command, and how to find them from CMake and
# pkg-config (src/cholmod adds the plug-in, beside the library). All paths in it are relative, so
# that the copy may be moved.
set(config_folder ${CMAKE_INSTALL_LIBDIR}/cmake/clba)

install(TARGETS clba EXPORT clba-targets
        LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR}
        ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}
        RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR}
        INCLUDES DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(FILES include/clba/clba.h include/clba/clba.hpp ${PROJECT_BINARY_DIR}/include/clba/clba_export.h
              ${PROJECT_BINARY_DIR}/include/clba/clba_version.h
        DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/clba)
install(EXPORT clba-targets NAMESPACE clba:: DESTINATION ${config_folder})

configure_package_config_file(cmake/clba-config.cmake.in
                              ${PROJECT_BINARY_DIR}/cmake/clba-config.cmake
                              INSTALL_DESTINATION ${config_folder})
# Before 1.0 a minor version may break the interface.
write_basic_package_version_file(${PROJECT_BINARY_DIR}/cmake/clba-config-version.cmake
                                 COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/cmake/clba-config.cmake
              ${PROJECT_BINARY_DIR}/cmake/clba-config-version.cmake
        DESTINATION ${config_folder})

file(RELATIVE_PATH CLBA_PREFIX_FROM_PC /${CMAKE_INSTALL_LIBDIR}/pkgconfig /)
configure_file(cmake/clba.pc.in ${PROJECT_BINARY_DIR}/cmake/clba.pc @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/cmake/clba.pc
        DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)

if(CLBA_BUILD_CLI)
  file(RELATIVE_PATH lib_from_bin /${CMAKE_INSTALL_BINDIR} /${CMAKE_INSTALL_LIBDIR})
  set_target_properties(clba_cli PROPERTIES INSTALL_RPATH $ORIGIN/${lib_from_bin})
  install(TARGETS clba_cli RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
endif()
install(FILES LICENSE README.md CITATION.cff DESTINATION ${CMAKE_INSTALL_DOCDIR})
