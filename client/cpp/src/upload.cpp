#include "upload.hpp"

#include <algorithm>
#include <fstream>
#include <stdexcept>

namespace moldline::internal {

namespace {

namespace fs = std::filesystem;

/// Bytes of one message, within the server's limit of 1 MiB.
constexpr std::size_t chunk = 1 << 20;

bool hidden(const fs::path& path) {
  const std::string name = path.filename().string();
  return name.front() == '.' || name == "__pycache__";
}

bool ends_with(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

v1::ArchiveKind archive_kind(const fs::path& path) {
  const std::string name = path.filename().string();
  if (ends_with(name, ".tar")) return v1::ARCHIVE_KIND_TAR;
  if (ends_with(name, ".tar.gz") || ends_with(name, ".tgz")) return v1::ARCHIVE_KIND_TAR_GZ;
  if (ends_with(name, ".zip")) return v1::ARCHIVE_KIND_ZIP;
  throw std::invalid_argument(path.string() + " is neither a folder nor an archive (.tar, .tar.gz, .tgz, .zip)");
}

}  // namespace

std::vector<fs::path> files(const fs::path& path, v1::SetupHeader& header) {
  if (!fs::is_directory(path)) {
    header.mutable_archive()->set_kind(archive_kind(path));
    header.mutable_archive()->set_size(fs::file_size(path));
    return {path};
  }
  std::vector<fs::path> found;
  for (auto entry = fs::recursive_directory_iterator(path); entry != fs::recursive_directory_iterator(); ++entry) {
    if (hidden(entry->path())) {
      if (entry->is_directory()) entry.disable_recursion_pending();
    } else if (entry->is_regular_file()) {
      found.push_back(entry->path());
    }
  }
  std::sort(found.begin(), found.end());
  header.mutable_files();
  for (const fs::path& file : found) {
    v1::FileEntry& entry = *header.mutable_files()->add_files();
    entry.set_path(file.lexically_relative(path).generic_string());
    entry.set_size(fs::file_size(file));
  }
  return found;
}

void upload(
    const v1::SetupHeader& header, const std::vector<fs::path>& files,
    const std::function<bool(const v1::CreateSetupRequest&)>& send) {
  v1::CreateSetupRequest first;
  *first.mutable_header() = header;
  if (!send(first)) return;
  for (std::size_t index = 0; index < files.size(); ++index) {
    std::ifstream stream(files[index], std::ios::binary);
    if (!stream) throw std::invalid_argument("cannot read " + files[index].string());
    std::string data(chunk, '\0');
    while (stream.read(data.data(), static_cast<std::streamsize>(chunk)) || stream.gcount() > 0) {
      v1::CreateSetupRequest next;
      next.mutable_chunk()->set_file(static_cast<std::uint32_t>(index));
      next.mutable_chunk()->set_data(data.data(), static_cast<std::size_t>(stream.gcount()));
      if (!send(next)) return;
    }
  }
}

}  // namespace moldline::internal
